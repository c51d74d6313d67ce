# Every target installs what it needs into .venv; only python3 with its venv module is expected.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
OUT ?= runs/refit

# Compiled programs are kept between runs, in the user's cache folder.
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)
export JAX_COMPILATION_CACHE_DIR ?= $(CACHE)/atmofit/jax

.DEFAULT_GOAL := help
.PHONY: help install refit test slow notebooks lint bench stability docs clean

help:  ## Show the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-9s %s\n", $$1, $$2}' Makefile

install: $(STAMP)  ## Create .venv and install atmofit into it

refit: $(STAMP)  ## Regenerate the coefficient matrices: tables, pictures and report in runs/refit
	$(BIN)/atmofit refit --out $(OUT)

# The tests compile hundreds of programs and run each on few nodes: quick compilation is worth more
# than quick programs there (half the time of the whole run). Both cores have a process of their own,
# so that no program is compiled in parts.
test slow notebooks: export XLA_FLAGS ?= --xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1
test: $(STAMP)  ## Run the tests on two processes, each file on one of them
	$(BIN)/python -m pytest -n 2 --dist loadfile -q -m "not slow"

slow: $(STAMP)  ## Run the tests that make test leaves out: comparisons and studies of over ten seconds
	$(BIN)/python -m pytest -n 2 --dist loadfile -q -m "slow and not notebooks"

notebooks: $(STAMP)  ## Execute the notebooks, small, with the seconds of each
	$(BIN)/python -m pytest -n 2 -q -m notebooks --durations=0 --durations-min=1 tests/test_notebooks.py

lint: $(STAMP)  ## Check style, formatting and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/basedpyright

stability: $(STAMP)  ## Try every function at its extremes: runs/stability/stability.md
	$(BIN)/atmofit stability

bench: $(STAMP)  ## Time the ladder of plans next to the exact oracle, and each kind of device at hand
	$(BIN)/python experiments/benchmark.py
	$(BIN)/python experiments/accelerator.py

docs: .venv/.docs  ## Build the documentation site: build/docs/index.html
	$(BIN)/python -m sphinx -q -W --keep-going -j 2 -b html docs/site build/docs

clean:  ## Remove .venv, results and caches of the tools
	rm -rf .venv runs build docs/site/notebooks dist .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "atmofit needs Python 3.11 or newer: make PYTHON=...")'
	@echo "installing into .venv (once, and after a change of pyproject.toml or constraints.txt)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

.venv/.docs: $(STAMP)
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@
