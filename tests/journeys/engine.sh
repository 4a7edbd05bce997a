# An engine programmer without PyTorch: export the shaders, replay them with what is in the folder alone.
set -eu
player=$1
rtdenoise export --out denoiser --size 64x36 --model fast
python "$player" denoiser
