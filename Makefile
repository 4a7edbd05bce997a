# make demo, make test: everything is set up on the way, on a machine that has Python 3.11 or later and make.
#
#   PYTHON=…   the interpreter to build .venv with (default: the first that is recent enough)
#   TORCH=…    what pip installs as PyTorch (default: the CPU build, or CUDA where an NVIDIA GPU is found)

VENV   := .venv
PYTHON ?=
TORCH  ?=
export PYTHON TORCH

# Threads that spin while they wait slow each other down wherever other processes run too.
export OMP_WAIT_POLICY ?= passive

# Packages come without bytecode (tools/setup.sh): who imports a module first keeps it for all others.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test lint wheel addon fuzz clean

help:  ## show this list
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/.ready-demo  ## denoise the bundled sequence: errors, times and pictures in demo/
	$(VENV)/bin/rtdenoise demo --out demo

test: $(VENV)/.ready-test  ## run all the tests, a file on each core; one that is skipped fails
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(VENV)/bin/python -m pytest -p no:cacheprovider --no-skips -n auto --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.ready-test  ## ruff
	$(VENV)/bin/ruff check

wheel: $(VENV)/.ready-build  ## build dist/*.whl
	$(VENV)/bin/python -m build --wheel

addon: wheel  ## build dist/rtdenoise-blender-*.zip, the add-on for Blender
	$(VENV)/bin/python tools/addon.py "$$(ls -t dist/rtdenoise-*.whl | head -1)"

fuzz: $(VENV)/.ready-test  ## attack files and commands for about an hour: kills, fuzzing, sanitizers; writes docs/results/attacks.md
	$(VENV)/bin/python -m pip install --quiet --editable '.[fuzz]'
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(VENV)/bin/python bench/attacks.py

clean:  ## remove .venv and whatever was built
	rm -rf $(VENV) build dist demo tests/failures tests/artefacts

$(VENV)/.ready-%: pyproject.toml tools/setup.sh
	@sh tools/setup.sh $*
	@touch $@
