# Everything happens in .venv, which any target makes when it is missing or older than pyproject.toml.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
STAMP := $(VENV)/.installed
MODE ?= quick
DEVICE ?= cpu

.PHONY: demo test lint bench gpu clean help

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 8

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || \
	  { echo "warpriver needs Python >= 3.10 as $(PYTHON): apt-get install python3, or make PYTHON=/path/to/python3"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "Python's venv is missing: apt-get install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@echo "installing into $(VENV), about 2 GB; this takes some minutes ..."
	$(RUN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]"
	@touch $@

demo: $(STAMP)  ## a terrain, its rivers, centuries of them: pictures and files go to out/demo
	@rm -rf out/demo
	$(RUN)/warpriver demo -o out/demo

test: $(STAMP)  ## all tests, in a process for each core
	$(RUN)/python -m pytest -n auto --dist worksteal

lint: $(STAMP)  ## ruff and mypy
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy

bench: $(STAMP)  ## all benchmarks at small sizes, into out/bench; MODE=full: all sizes, into benchmarks/results; DEVICE=cuda
	$(RUN)/python -m pip install --quiet --disable-pip-version-check -e ".[bench]"
	$(RUN)/python benchmarks/all.py --device $(DEVICE) $(if $(filter full,$(MODE)),--full)

gpu: $(STAMP)  ## on a CUDA machine, in six minutes: kernel tests, whole runs, the same bits again, speed; into out/gpu
	$(RUN)/python benchmarks/gpu.py --out out/gpu

clean:  ## remove what the other targets made
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
