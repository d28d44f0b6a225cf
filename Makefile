# Every target sets up what it needs on a machine with Python 3.11 to 3.13, git and make.
SHELL := /bin/bash
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
TOOLS := .venv/.tools_installed
CHECKED := .venv/.settings_checked
# Words after `make run`; what the environment calls by such names is no option.
NAMES := ROW SIZE SOURCE FEATURES ABLATION SEED DATASET CATEGORY BASE_SHAPE BASELINE
WORDS := $(foreach name,$(.VARIABLES),$(if $(filter command,$(firstword $(origin $(name)))),$(name)))
OPTIONS := $(foreach option,$(filter $(WORDS),$(NAMES)),$(if $($(option)),$(option)))
STRAY := $(firstword $(filter-out $(NAMES) PYTHON -%,$(WORDS)))
ifneq ($(if $(filter BASELINE,$(OPTIONS)),$(filter-out 1,$(words $(BASELINE)))$(filter-out hologan colmap,$(BASELINE))),)
$(error BASELINE is $(BASELINE); expected hologan or colmap)
endif
ifneq ($(if $(filter run,$(MAKECMDGOALS)),,$(OPTIONS)),)
$(error $(firstword $(OPTIONS)) is an option of make run: make run $(foreach option,$(OPTIONS),$(option)=$($(option))))
endif
ifneq ($(filter run,$(MAKECMDGOALS)),)
$(if $(STRAY),$(error $(STRAY) is no option of make run; expected: $(NAMES)))
$(if $(filter ROW,$(OPTIONS)),,$(error name a row: make run ROW=toybox-car, or another of those in params.yaml))
endif
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
# The commands of an environment name its folder: where that was moved, it is set up anew.
MOVED := $(shell grep -qsxvF "$(CURDIR)" $(STAMP) && echo FORCE)
# The stages' commands in dvc.yaml call `python`.
export PATH := $(CURDIR)/$(BIN):$(PATH)
# Threads that wait should spin for a moment and then sleep: spinning on halves the speed of a busy machine, sleeping at
# once takes a third off that of a quiet one (docs/decisions/speed.md).
export GOMP_SPINCOUNT := 20000

.PHONY: repro install test check run bench dependencies tables clean help FORCE

repro: $(CHECKED)  ## run the pipeline: by default the toybox car, from pictures to a page
	dvc repro
	@kato3d runs > /dev/null

install: $(STAMP)  ## set up the environment alone

run: $(if $(filter BASELINE,$(OPTIONS)),$(TOOLS),$(STAMP))  ## add a run to params.yaml and run it: ROW=, and if you like (README.md) SIZE=laptop|paper|laptop-imagenet|paper-imagenet SOURCE= FEATURES= ABLATION= SEED= DATASET= CATEGORY= BASE_SHAPE= BASELINE=
	@python -m stages.run_row $(foreach option,$(OPTIONS),--$(shell echo $(option) | tr A-Z a-z)="$$$(option)")
	@kato3d runs > /dev/null

test: $(TOOLS)  ## the whole test suite
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

check: $(TOOLS)  ## style, types and the direction of imports
	ruff check
	ruff format --check
	pyright
	lint-imports

BENCH ?= bench
bench: $(TOOLS)  ## time the renderer and the training steps, on a GPU where there is one: results/bench/BENCH.json, bench.json without BENCH=
	mkdir -p results/bench
	pytest benchmarks --override-ini addopts=--import-mode=importlib --override-ini "python_files=bench_*.py" \
		--benchmark-json results/bench/$(BENCH).json

dependencies: $(TOOLS)  ## rewrite the code dependencies of dvc.yaml
	python -m tests.project.import_closure

tables: $(TOOLS)  ## rewrite the tables of README.md and docs/ from the results that are committed or staged
	python -m tests.project.result_tables

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*  ## /\1\t/p' Makefile | expand -t 14

clean:  ## remove the environment and restart states; models and results stay
	rm -rf .venv .checkpoints

$(STAMP): constraints.txt pyproject.toml $(MOVED)
	@$(if $(MOVED),rm -rf .venv)
	@$(BIN)/python -c "import pip; $(SUPPORTED)" 2> /dev/null || { \
		$(PYTHON) -c "$(SUPPORTED)" || { echo "Python 3.11 to 3.13 is needed; name one, such as PYTHON=python3.12, behind make" >&2; exit 1; }; \
		$(PYTHON) -m venv --clear .venv; }
	@echo "installing into .venv: two to three minutes"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[pipeline]"
	@$(BIN)/python -c "import pymeshlab" || { echo "MeshLab does not load: install the libraries of OpenGL, on Debian and Ubuntu by apt-get install libgl1 libopengl0" >&2; exit 1; }
	@echo "$(CURDIR)" > $@

# Settings of late stages are looked at before the first one starts.
$(CHECKED): $(STAMP) params.yaml
	@python -m stages.check_settings
	@touch $@

$(TOOLS): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[pipeline,remote,video,baselines,development]"
	touch $@
