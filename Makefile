# make demo: the main job in small.  make test: every check.  make docs: the site, docs/build/html.  All set up .venv first.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
export PYTHONUNBUFFERED := 1

.PHONY: demo test test-slow format wheel docs

demo: $(READY)
	$(BIN)/impact demo

# worksteal: tests that are neighbours share fixtures and compiled code, and mostly stay in one worker.
test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n 2 --dist worksteal -m "not slow"

test-slow: $(READY)
	$(BIN)/pytest -n 2 --dist worksteal -m slow

# The same bytes from the same commit, wherever it is built.
wheel: $(READY)
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: .venv/.docs-ready
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/build/html

.venv/.docs-ready: $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev,docs]"
	touch $@

# torch goes first: with it in place no other package asks for another build of it.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "impact-envs needs Python 3.11 or newer; set PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt torch
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $@
