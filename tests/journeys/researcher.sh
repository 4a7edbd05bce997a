# A researcher: own frames with references to clips, a few steps of training, the measured report.
set -eu
rtdenoise inspect shots/a | tail -n 1
rtdenoise clips shots/a --out clips/train --size 32 --frames 4
rtdenoise clips shots/b --out clips/val --size 32 --frames 4
rtdenoise train --data clips/train --val clips/val --out run --model fast --init "$1" --signal color \
    --steps 3 --batch 1 --size 32 --frames 3
rtdenoise evaluate shots/b --out out --methods noisy accumulate fast mine=run/weights.safetensors
rtdenoise report out
