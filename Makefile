# Two commands, each complete on a fresh machine with Python 3.11 or newer and make:
#   make compare   installs, runs laws and learned policies on all scenarios, ends with the answer: 2 minutes on 2 cores
#   make test      installs the test extra with PyTorch, runs linters, types and tests: 9 minutes on 4 cores
# Both show their progress: pip its downloads, the comparison and pytest a bar.
# The pins of other frameworks conflict, so each has an environment of its own in .ecosystem/:
#   make ecosystem runs the examples of every framework, writes the table of docs/ecosystem.md

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= results
PIP     = $(BIN)/pip install --no-compile --disable-pip-version-check --constraint constraints.txt
PYTEST  = $(BIN)/pytest --numprocesses auto --dist worksteal

.PHONY: compare reproduce test lint types unit docs ecosystem ray soak lowest newest smoke audit clean

compare: $(VENV)/.bench
	$(BIN)/ptne compare --out $(OUT)/comparison

reproduce: $(VENV)/.bench
	$(BIN)/ptne reproduce --out $(OUT)/paper

docs: $(VENV)/.docs
	$(BIN)/sphinx-build --builder html --jobs auto --conf-dir docs --fresh-env --fail-on-warning --keep-going --quiet . $(OUT)/site
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
	$(PYTEST)

# All tests with large counts of random cases, then 100,000 random episodes in random worlds.
soak: $(VENV)/.test
	PTNE_SOAK=1 $(PYTEST)
	$(BIN)/python tests/soak.py --episodes 100000

# The tests that need neither torch nor the whole source tree, with the oldest packages that pyproject.toml admits, or
# with the newest: make newest PYTHON=python3.13
# Searches of gains were published with numpy 2: numpy 1.26 rounds logarithms otherwise, and switching laws amplify it.
lowest: RESOLUTION := lowest-direct
lowest: DESELECT := --deselect tests/experiments/test_tuning.py::test_published_trials_are_those_of_their_jobs
newest: RESOLUTION := highest
lowest newest:
	$(PYTHON) -m venv --clear $(VENV)-$@
	$(VENV)-$@/bin/pip install --quiet --disable-pip-version-check uv
	$(VENV)-$@/bin/uv pip install --quiet --compile-bytecode --python $(VENV)-$@/bin/python --resolution $(RESOLUTION) \
		--editable '.[bench]' 'filelock>=3.13' 'hypothesis>=6.100' 'pytest>=8.3' 'pytest-xdist>=3.6'
	$(VENV)-$@/bin/pytest --numprocesses auto --dist worksteal \
		--ignore tests/test_docs.py --ignore tests/test_examples.py --ignore tests/test_ecosystem.py \
		--ignore tests/test_benchmarks.py --ignore tests/test_site.py $(DESELECT)

# Wheel and source archive, each installed in an empty environment and used outside the source tree.
smoke: SMOKE := $(abspath $(VENV)-smoke)
smoke:
	$(PYTHON) -m venv --clear $(SMOKE)
	$(SMOKE)/bin/pip install --quiet --disable-pip-version-check build
	$(SMOKE)/bin/python -m build --outdir $(SMOKE)/dist .
	for archive in $(SMOKE)/dist/*; do \
		$(PYTHON) -m venv --clear $(SMOKE)/empty && cp tests/smoke.py $(SMOKE)/empty && (cd $(SMOKE)/empty && \
		bin/pip install --quiet --disable-pip-version-check $$archive && bin/python -W error smoke.py && \
		bin/pip install --quiet --disable-pip-version-check "$$archive[bench]" && bin/python smoke.py bench) || exit 1; \
	done

# Published vulnerabilities of the packages that users install; a package without an answer is a failure.
audit:
	$(PYTHON) -m venv --clear $(VENV)-audit
	$(VENV)-audit/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt \
		--editable '.[fast,sb3]' pip-audit
	$(VENV)-audit/bin/pip freeze --exclude-editable > $(VENV)-audit/requirements.txt
	$(VENV)-audit/bin/pip-audit --strict --no-deps --disable-pip --requirement $(VENV)-audit/requirements.txt

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("ptne_env needs Python 3.11 or newer, $(PYTHON) is " + sys.version.split()[0] + "; set PYTHON=...") if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.bench: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo 'Installing in $(VENV), about 15 seconds'
	$(PIP) --editable '.[bench]'
	touch $@

$(VENV)/.docs: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) --editable '.[docs]'
	touch $@ $(VENV)/.bench

$(VENV)/.test: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo 'Installing in $(VENV) with PyTorch, about two minutes'
	$(PIP) --editable '.[test]'
	touch $@ $(VENV)/.docs $(VENV)/.bench

# The tests on a Ray cluster of two nodes on this machine, whose second node is killed in the middle.
ray: $(VENV)/.ray
	$(BIN)/pytest --show-capture=no tests/experiments/test_cluster.py

$(VENV)/.ray: $(VENV)/.test
	$(PIP) --editable '.[test,ray]'
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-* $(OUT) .ecosystem
