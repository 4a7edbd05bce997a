#!/bin/sh
# Make the weights that ship, from the first clip on:
#     sh tools/train_weights.sh default|fast|many|hybrid|hybrid-fast|hybrid-large|hybrid-many|hybrid-large-many|combiner [cpu|cuda]
# `settings` instead of a model trains the paper's settings A, B and C, which docs/results/quality.md compares, into
# runs/paper-A, -B and -C.
#
# Renders clips, cleans their references and trains. Needs .venv with the extras `render` and `bench`, as
# `sh tools/setup.sh test` sets it up. Every command resumes where it was stopped and skips finished work in seconds, so the
# script may run in pieces of ten minutes:
#
#     while timeout 600 sh tools/train_weights.sh default cuda; [ $? = 124 ]; do :; done
#
# Rendering finds a GPU by itself. In the environment:
#   PROCESSES=2     trains in two processes
#   SCENES=FOLDER   scene files, FOLDER/NAME/scene.xml (docs/reference/models/default.md names them); without them generated
#                   scenes take their place
#   ASSETS=FOLDER   for all but `fast`: a library of assets with its index.json
#   DRY=1           prints the commands and runs none
set -eu
cd "$(dirname "$0")/.."
trap 'exit 143' TERM # after the running command has written its checkpoint
model=${1:-} device=${2:-cpu}
case $model in
    default | fast | many | hybrid | hybrid-fast | hybrid-large | hybrid-many | hybrid-large-many | combiner | settings) ;;
    *) echo "expected default, fast, many, hybrid, hybrid-fast, hybrid-large, hybrid-many, hybrid-large-many, combiner or settings, got '$model'" >&2; exit 2 ;;
esac
case $model in default | many | combiner)
    [ -n "${ASSETS:-}" ] || { echo "expected ASSETS=FOLDER, a library of assets" >&2; exit 2; };;
esac

run() {
    echo "$*"
    [ -n "${DRY:-}" ] || .venv/bin/"$@"
}

# --- the clips --------------------------------------------------------------------------------------------------------

clips() { # NAME OPTIONS...: clips into data/NAME, and with cleaned references into data/NAME-clean
    name=$1; shift
    run rtdenoise clips --out "data/$name" "$@"
    run rtdenoise clean "data/$name" --out "data/$name-clean"
}

wide="--generator 2"
noisy="--reference-error 0.2"
files=${SCENES:+--scenes $SCENES --motions examples/motions}
two=${SCENES:+--exclude street dining-room} # of the other scenes this set shows three, none of the measured ones
ship() { # NAME FILE, or a mean: NAME FILE=SHARE...
    run python tools/ship_weights.py "$@"
    [ "$1" != "$model" ] || in_bytes
}
in_bytes() { # what --precision int8 needs, found on frames such as the model will see
    small="--width 256 --height 144 --frames 8 --reference-spp 0" seen=data/calibration
    for scene in ${SCENES:+classroom living-room veach-ajar spaceship dungeon toyroom}; do
        run rtdenoise render "$SCENES/$scene/scene.xml" --motion examples/motions/$scene.toml $small --out $seen/$scene
    done
    [ -z "${SCENES:-}" ] || run rtdenoise render "$SCENES/classroom/scene.xml" --motion examples/motions/classroom.toml $small \
        --spp 16 --out $seen/classroom16
    for scene in wide:11 wide:12 sunlit:5 procedural:3; do
        run rtdenoise render $scene $small --out "$seen/$(echo $scene | tr -d :)"
    done
    run python tools/weights_in_bytes.py "$model" "rtdenoise/weights/$model.int8" $seen/*
}
case $model in # the kernels of a model and a network of OIDN's, both as they are: nothing to train
    hybrid | hybrid-fast | hybrid-large)
        case $model in hybrid) quality=balanced;; *) quality=${model#hybrid-};; esac
        run python tools/begin_hybrid.py "rtdenoise/weights/$model.safetensors" $quality
        in_bytes
        exit;;
    hybrid*-many) # names alone
        run python tools/join_hybrid.py "rtdenoise/weights/$model.safetensors" many "${model%-many}"
        exit;;
esac
run rtdenoise clips --out data/val --generator 1 --count 24 --seed 1000000 --reference-spp 128
if [ "$model" = settings ]; then
    clips some-scenes $wide --count 56 --seed 9000 $noisy $files
    clips some-sun --count 52 --seed 31000 $noisy --sun 0.6
elif [ "$model" != combiner ]; then
    clips train --generator 1 --count 200
    clips wide $wide --count 12
    clips mixed $wide --count 12 --seed 7000 --reference-error 0.02 $files $two
    clips scenes $wide --count 80 --seed 9000 $noisy $files
    clips sun $wide --count 240 --seed 21000 $noisy --sun 1
    clips sun3 --count 120 --seed 31000 $noisy --sun 0.6
    clips wide3 --count 189 --seed 41000 $noisy --sun 0.5 $files
fi
[ "$model" != fast ] || clips calm --count 136 --seed 51000 $noisy --sun 0.4 --calm 1 $files
stills="--assets ${ASSETS:-} $files --size 192 --frames 1"
case $model in default | many)
    clips stills $stills --reference-error 0.5 --count 195
    clips more-stills $stills --reference-error 0.5 --count 276 --seed 1
    clips samples8 --count 32 --spp 8 --frames 9 --seed 52000 $noisy --sun 0.4 --calm 0.2 $files;;
esac
if [ "$model" = many ]; then # small pictures, with shadows a pixel or two wide
    small_options="--frames 1 --sun 0.6 $files"
    clips small64 --count 51 --spp 64 --seed 60064 --reference-error 0.003 $small_options
    clips small16 --count 24 --spp 16 --seed 60016 --reference-error 0.005 $small_options
    clips samples16 --count 2 --spp 16 --frames 6 --seed 71016 --reference-error 0.02 --sun 0.6 --calm 0.4 $files
fi
if [ "$model" = default ]; then
    clips one-sample-stills $stills --reference-error 0.5 --count 324 --seed 2 --most-spp 1
    clips history --count 96 --frames 9 --seed 51000 $noisy --sun 0.4 --calm 0.2 $files
fi
levels() { # NAME OPTIONS...: the same clips at 1, 4 and 16 samples a pixel, with references of 64 and more
    name=$1; shift
    run python bench/combine_clips.py --out "data/$name" $files --size 128 --frames 5 --levels 1 4 16 64 --half 32 \
        --windows 2 "$@"
    [ "$model" != combiner ] || return 0
    for spp in 01 04 16; do
        run rtdenoise clean "data/$name/spp$spp" --out "data/$name-clean/spp$spp"
    done
}
case $model in default | many | combiner)
    levels levels --count 72 --seed 81
    levels levels720 --count 32 --seed 82 --assets "$ASSETS";;
esac
if [ "$model" = combiner ]; then # it corrects raw references' noisy frames, as two denoisers denoised them
    folders=
    for name in levels levels720; do
        for spp in 01 04 16 64; do folders="$folders data/$name/spp$spp"; done
    done
    run rtdenoise estimates $folders --methods oidn default
    run rtdenoise train --out runs/combiner-last --model combiner --device "$device" --data$folders --signal both \
        --frames 5 --batch 4 --size 96 --optimiser muon --lr 4e-4 --warmup 50 --steps 1800
    run python tools/ship_weights.py combiner runs/combiner-last/weights.safetensors
    exit
fi
if [ "$model" = default ]; then # long histories
    long="--frames 3 --lead-in 20 --sun 0.5 --calm 0.3"
    clips long --count 71 --seed 94000 --reference-error 0.01 $long
    clips long-scenes --count 73 --seed 95000 --reference-error 0.02 $long $files
    clips sharp-stills $stills --reference-error 0.01 --count 138 --seed 3 --most-spp 1
fi

# --- the weights ------------------------------------------------------------------------------------------------------

loss="--loss-exposure 4 --huber 0.2" # of our own networks; the paper's takes the defaults
fields= # of the configuration, other than the preset's
train() { # RUN OPTIONS...: train $network into runs/NETWORK-RUN
    out=runs/$network-$1; shift
    several=
    [ "${PROCESSES:-1}" = 1 ] || several="torchrun --standalone --nproc-per-node $PROCESSES -m --"
    run $several rtdenoise train --out "$out" --model "$network" --device "$device" --val data/val --signal both \
        $loss $fields --optimiser muon "$@"
}
train_on() { # OUT FROM OPTIONS...: $network, with stills in every second step
    out=$1 from=$2; shift 2
    run rtdenoise train --out "$out" --model "$network" $fields --device "$device" --init "$from" --signal both $loss \
        --batch 1 --warmup 50 "$@"
}
after() { # RUN: start from its weights
    echo "--init runs/$network-$1/weights.safetensors"
}

first="--data data/train-clean data/wide-clean data/mixed-clean data/scenes-clean"
sunny="$first data/sun-clean data/sun3-clean"
all="$sunny data/wide3-clean"
if [ "$model" = settings ]; then
    network=paper loss=
    on="--data data/some-scenes-clean data/some-sun-clean --init rtdenoise/weights/paper.safetensors"
    on="$on --steps 600 --lr 4e-4 --validate-every 300"
    train A $on --motion traditional --no-occlusion-loss
    train B $on --no-occlusion-loss
    train C $on
    exit
fi
if [ "$model" = fast ]; then
    network=fast
    train single $first --frames 1 --batch 16 --steps 1200 --lr 8e-4 --no-occlusion-loss
    train clips $first $(after single) --frames 6 --steps 1200 --lr 6e-4 --cuts 0.4 --validate-every 300
    train sun $first data/sun-clean $(after clips) --frames 6 --steps 900 --lr 4e-4 --cuts 0.4 --validate-every 450
    train edges $all $(after sun) --frames 6 --steps 2000 --lr 6e-4 --cuts 0.5 --relight 0.05 --validate-every 500
    train last $all data/calm-clean $(after edges) --steps 1500 --lr 5e-4 --cuts 0.5 --relight 0.05 --validate-every 500
else # the first runs of `default`
    network=default fields="--set detail=false"
    train single $first --frames 1 --batch 16 --steps 1500 --lr 5e-4 --no-occlusion-loss
    train clips $first $(after single) --steps 4800 --lr 4e-4 --cuts 0.5 --validate-every 400
    train sun $sunny $(after clips) --steps 6000 --lr 4e-4 --cuts 0.5 --validate-every 800
fi
# on clips with better references, of which some have long histories
sharp="--data data/long-clean data/long-scenes-clean data/levels-clean/spp01 data/levels720-clean/spp01"
sharp="$sharp --most-spp 1 --frames 3 --lead-in 20 --cuts 0.1 --shade 0.15 --loss-power 0.5 --lr 5e-4"
single="data/sharp-stills-clean data/levels-clean/spp01 data/levels720-clean/spp01 data/long-clean data/long-scenes-clean"

if [ "$model" = fast ]; then
    ship fast runs/fast-last/weights.safetensors
    exit
fi

train edges $all $(after sun) --steps 2400 --lr 5e-4 --cuts 0.5 --relight 0.05 --validate-every 400
train base $sunny $(after edges) --steps 1000 --lr 3e-4 --cuts 0.5 --validate-every 500

# --- `many` and `default`: from there, on stills of a library ---------------------------------------------------------

base=runs/default-base/weights.safetensors many=runs/many-one/weights.safetensors
fields="--set detail=true"

large="--stills data/stills-clean data/more-stills-clean" root="--cuts 0.3 --loss-power 0.5 --frames 8"
train_on runs/many-one $base --data data/samples8-clean $large --least-spp 4 --lr 1e-3 --steps 6000 --shade 0.3 $root
if [ "$model" = many ]; then
    mean=runs/many-one/mean.safetensors second=runs/many-small/weights.safetensors
    ship $mean $base=0.35 $many=0.65
    small="data/small64 data/small64 data/small16 data/small16" # each twice: they are few
    train_on runs/many-small $mean --data data/samples8-clean data/samples16 $large $small --lr 5e-4 --steps 4000 --seed 3 \
        --least-spp 4 --cuts 0.3 --shade 0.2 --loss-power 0.1 --frames 6
    ship runs/many-small/mean.safetensors $mean=0.35 $second=0.65
    clips small16 --count 60 --spp 16 --seed 60016 --reference-error 0.005 $small_options # more of them
    clips small4 --count 43 --spp 4 --seed 60004 --reference-error 0.005 $small_options
    small="data/small64 data/small16 data/small4"
    counts=; for name in levels levels720; do counts="$counts data/$name-clean/spp04 data/$name-clean/spp16"; done
    sharp="--data$counts --lr 5e-4 --least-spp 4 --cuts 0.2 --shade 0.2 --loss-power 0.1 --frames 5"
    train_on runs/many-sharp runs/many-small/mean.safetensors $sharp --stills $small --steps 3000 --seed 4
    train_on runs/many-last runs/many-sharp/weights.safetensors $sharp --stills $small$counts --steps 3300 --seed 5
    ship many runs/many-sharp/weights.safetensors=0.65 runs/many-last/weights.safetensors=0.35
    exit
fi
few="--data data/history-clean --most-spp 1 --lr 5e-4 --relight 0.05 --shade 0.15 $root"
few="$few --stills data/stills-clean data/more-stills-clean"
train_on runs/default-one $base --steps 2400 $few
ship runs/default-one/mean.safetensors $base=0.4 $many=0.3 runs/default-one/weights.safetensors=0.3
train_on runs/default-two runs/default-one/mean.safetensors --steps 4000 --seed 1 $few
ship runs/default-two/mean.safetensors $base=0.25 $many=0.3 runs/default-two/weights.safetensors=0.45
train_on runs/default-three runs/default-two/mean.safetensors --steps 4000 --seed 2 $few data/one-sample-stills-clean
ship runs/default-three/mean.safetensors $base=0.5 $many=0.2 runs/default-three/weights.safetensors=0.3
mean=runs/default-three/mean.safetensors
train_on runs/default-sharp $mean $sharp --stills data/sharp-stills-clean --relight 0.05 --steps 3000 --seed 3
ship runs/default-sharp/mean.safetensors $mean=0.5 runs/default-sharp/weights.safetensors=0.5
train_on runs/default-last runs/default-sharp/mean.safetensors $sharp --stills $single --relight 0.1 --steps 3300 --seed 4
# trained on running means, run on recent frames: docs/notes/recall.md
ship default $mean=0.4 runs/default-last/weights.safetensors=0.6 set:recent=8
