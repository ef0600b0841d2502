# Two commands, each complete on a fresh machine with Python 3.11 or newer and make:
#   make compare   installs, runs the comparison of all laws on all scenarios, says where the results are
#   make test      installs the test extra, runs linters, types and tests
# and, because the pins of these frameworks conflict, one environment each in .ecosystem/:
#   make ecosystem runs the examples of every framework, writes the table of docs/ecosystem.md

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= results

.PHONY: compare reproduce ecosystem test lint types unit clean

compare: $(VENV)/.bench
	$(BIN)/ptne compare --json $(OUT)/compare.json --csv $(OUT)/compare.csv --report $(OUT)/report/index.html

reproduce: $(VENV)/.bench
	$(BIN)/ptne reproduce --out $(OUT)/paper

ecosystem:
	$(PYTHON) examples/ecosystem/run.py

test: lint types unit

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.test
	$(BIN)/mypy

unit: $(VENV)/.test
	$(BIN)/pytest --numprocesses auto

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("ptne_env needs Python 3.11 or newer, $(PYTHON) is " + sys.version.split()[0] + "; say PYTHON=...") if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.bench: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

$(VENV)/.test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@ $(VENV)/.bench

clean:
	rm -rf $(VENV) $(OUT) .ecosystem
