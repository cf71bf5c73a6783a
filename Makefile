# Needs Python 3.11 or later, git and make. Every target makes .venv by itself, from
# requirements.lock; PYTHON=/path/to/python chooses the interpreter it is made with.

PYTHON ?=
PYTHONS := python3.13 python3.12 python3.11 python3 python

VENV := .venv
BIN := $(VENV)/bin
# Written last, so that a .venv whose making was interrupted has none and is made anew.
LOCKED := $(VENV)/.made-from-lock
READY := $(VENV)/.package-installed
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv demo docs test study bench lint lock clean

help:  ## show this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1@\2/p' Makefile | awk -F@ '{printf "%-12s %s\n", $$1, $$2}'

venv: $(READY)  ## make .venv, which every target below does by itself where it needs one

demo: $(READY)  ## the paper's tables and figures, into out/paper
	$(BIN)/difffric paper --out out/paper

docs: $(READY)  ## the docs site, its notebooks executed, into out/site (minutes)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet \
	  -c docs/site -d out/.doctrees . out/site
	@echo "written: out/site/index.html"

test: $(READY)  ## the tests; some need Debian's GHDL, yosys, Icarus, Chromium, and are else skipped
	@sh tests/tools.sh
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

study: $(READY)  ## 1800 calibrations, 4410 diagnoses (a day; CASES=50: of each part), the slow tests
	$(BIN)/python -m studies.calibration $(if $(CASES),--cases $(CASES))
	$(BIN)/python -m studies.slides $(if $(CASES),--cases $(CASES))
	$(BIN)/python -m studies.diagnosis $(if $(CASES),--cases $(CASES))
	$(BIN)/python -m pytest -m slow

bench: $(READY)  ## the benchmarks, into .benchmarks/latest.json
	@mkdir -p .benchmarks
	$(BIN)/python -m pytest benchmarks --benchmark-only --benchmark-json=.benchmarks/latest.json
	$(BIN)/python -m benchmarks.table .benchmarks/latest.json

lint: $(READY)  ## style, types and the direction of imports: all four checks run, any may fail it
	@failed=; \
	for check in "ruff check" "ruff format --check" "pyright" "lint-imports"; do \
	  echo "== $$check"; $(BIN)/$$check || failed="$$failed [$$check]"; \
	done; \
	if [ -n "$$failed" ]; then echo "make lint: failed:$$failed" >&2; exit 1; fi

lock:  ## remake requirements.lock from pyproject.toml (needs uv)
	@command -v uv >/dev/null || { echo "make lock: uv is needed, and is not on PATH" >&2; exit 1; }
	uv pip compile --universal --generate-hashes --no-emit-index-url --extra dev \
	  --upgrade pyproject.toml -o requirements.lock

clean:  ## remove .venv and everything that was made
	rm -rf $(VENV) out .benchmarks .pytest_cache .ruff_cache .import_linter_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(LOCKED): requirements.lock
	@python=; \
	for candidate in $(if $(PYTHON),"$(PYTHON)",$(PYTHONS)); do \
	  if "$$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; \
	  then python="$$candidate"; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "make: no Python 3.11 or later found (tried: $(if $(PYTHON),$(PYTHON),$(PYTHONS)))." >&2; \
	  echo "make: install one, or name it: make PYTHON=/path/to/python3.13 ..." >&2; exit 1; \
	fi; \
	if ! "$$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then \
	  echo "make: $$python lacks venv or ensurepip (on Debian: install python3-venv)." >&2; exit 1; \
	fi; \
	echo "making $(VENV) with $$python ($$("$$python" -V 2>&1)): this takes minutes"; \
	"$$python" -m venv --clear $(VENV)
	$(PIP) install --quiet --require-hashes -r requirements.lock
	@touch $@

# Editable: the package is installed again only where its metadata may have changed.
$(READY): $(LOCKED) pyproject.toml
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@$(PIP) check >$(VENV)/check.txt || { cat $(VENV)/check.txt >&2; \
	  echo "make: pyproject.toml and requirements.lock differ: make lock" >&2; exit 1; }
	@touch $@
