# Two commands, each complete on a fresh machine with Python 3.11 or newer and make:
#   make compare   installs, runs the comparison of all laws on all scenarios, says where the results are
#   make test      installs the test extra, runs linters, types and tests
# and, because the pins of these frameworks conflict, one environment each in .ecosystem/:
#   make ecosystem runs the examples of every framework, writes the table of docs/ecosystem.md

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= results

.PHONY: compare reproduce test lint types unit docs ecosystem ray soak lowest newest smoke audit clean

compare: $(VENV)/.bench
	$(BIN)/ptne compare --json $(OUT)/compare.json --csv $(OUT)/compare.csv --report $(OUT)/report/index.html

reproduce: $(VENV)/.bench
	$(BIN)/ptne reproduce --out $(OUT)/paper

docs: $(VENV)/.docs
	$(BIN)/sphinx-build --builder html --conf-dir docs --fresh-env --fail-on-warning --keep-going --quiet . $(OUT)/site
	@echo 'Site written to $(OUT)/site/index.html: open it in a browser'

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

soak: $(VENV)/.test
	$(BIN)/python tests/soak.py --episodes 100000

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("ptne_env needs Python 3.11 or newer, $(PYTHON) is " + sys.version.split()[0] + "; say PYTHON=...") if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.bench: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

$(VENV)/.docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@ $(VENV)/.bench

$(VENV)/.test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@ $(VENV)/.docs $(VENV)/.bench

# A Ray cluster of two nodes on this machine, one of which is killed in the middle.
ray: $(VENV)/.ray
	$(BIN)/pytest --show-capture=no tests/evaluation/test_cluster.py

$(VENV)/.ray: $(VENV)/.test
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test,ray]'
	touch $@

clean:
	rm -rf $(VENV) $(OUT) .ecosystem
