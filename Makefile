# Two commands, each complete on a fresh machine with Python 3.11 or newer and make:
#   make compare   installs the package in .venv, runs laws and learned policies on ptne-v1, ends with the answer
#   make test      installs test tools with PyTorch, runs linters, types and tests
# While you work: make quick.

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= results
# Tests and workers start many interpreters, which read bytecode instead of compiling every package again: it is written
# below VENV, and even where the environment says that none is written.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(abspath $(VENV))/bytecode
PIP     = $(BIN)/pip install --no-compile --disable-pip-version-check --constraint constraints.txt
PYTEST  = $(BIN)/pytest --numprocesses auto --dist worksteal
CORE    = tests/shared tests/games tests/world tests/perception tests/laws tests/envs tests/evaluation tests/test_import.py tests/test_misuse.py

.PHONY: compare test quick lint types unit core publish reproduce docs ecosystem soak dist smoke release-check ray lowest \
	newest clean

compare: $(VENV)/.bench
	$(BIN)/ptne compare --out $(OUT)/ptne-v1

test: lint types unit

# The core in half a minute, without installing anything anew. It leaves out the tests of the core that take longest: laws
# (one file stays, which compares them with an independent program), fresh interpreters, pictures, adapters to PyTorch's
# libraries, the audit of shipped policies, files and figures of trajectories, and the simulations of intervals.
QUICK = $(filter-out tests/laws tests/test_import.py,$(CORE)) tests/laws/test_against_reference.py tests/test_golden.py
LEFT  = $(addprefix tests/,envs/test_rendering.py envs/test_sb3.py envs/test_torchrl.py \
	evaluation/test_audit.py evaluation/test_statistics.py evaluation/test_trajectories.py)
quick:
	@test -x $(BIN)/pytest || $(MAKE) $(VENV)/.test
	$(PYTEST) --quiet $(QUICK) $(addprefix --ignore ,$(LEFT))
	@echo 'Left out: tests/laws but for one file, tests/test_import.py $(LEFT), all layers, linters, types'

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(VENV)/.test
	$(BIN)/mypy

unit: $(VENV)/.test
	$(PYTEST)

# The tests of the core with nothing installed but its five packages and pytest.
core:
	$(PYTHON) -m venv --clear $(VENV)-core
	$(VENV)-core/bin/pip install --quiet --disable-pip-version-check --editable . hypothesis pytest
	$(VENV)-core/bin/pytest $(CORE)

# Run the suites again, and write every table of README, docs and baselines.
publish: $(VENV)/.test
	$(BIN)/python -m baselines.publish

reproduce: $(VENV)/.bench
	$(BIN)/python -m baselines.reproduce --out $(OUT)/paper

docs: $(VENV)/.docs
	$(BIN)/sphinx-build --builder html --conf-dir docs --fail-on-warning --jobs auto --quiet . $(OUT)/site
	@echo 'Site written to $(OUT)/site/index.html: open it in a browser'

# The examples of other frameworks, each in an environment of its own in .ecosystem/, which take 20 GB.
ecosystem: $(VENV)/bin/python
	$(BIN)/python examples/ecosystem/run.py

# All tests with large counts of random cases, then with other arithmetic (the kernels of another processor, numpy
# without the SIMD extensions that it found here), then random episodes in random worlds.
SIMD = import numpy; print(*numpy.show_config("dicts")["SIMD Extensions"]["found"])
soak: core $(VENV)/.test
	PTNE_SOAK=1 $(PYTEST)
	OPENBLAS_CORETYPE=Haswell $(PYTEST)
	NPY_DISABLE_CPU_FEATURES="$$($(BIN)/python -c '$(SIMD)')" $(PYTEST)
	$(BIN)/python tests/soak.py --episodes 100000

# Wheel and source archive in dist/.
dist:
	rm -rf dist
	$(PYTHON) -m venv --clear $(VENV)-dist
	$(VENV)-dist/bin/pip install --quiet --disable-pip-version-check build twine
	$(VENV)-dist/bin/python -m build .
	$(VENV)-dist/bin/twine check --strict dist/*

# Each of them installed in an empty environment and used outside the source tree.
smoke: SMOKE := $(abspath $(VENV)-smoke)
smoke: dist
	for archive in $(abspath dist)/*; do \
		$(PYTHON) -m venv --clear $(SMOKE) && cp tests/smoke.py $(SMOKE) && (cd $(SMOKE) && \
		bin/pip install --quiet --disable-pip-version-check $$archive && bin/python -W error smoke.py && \
		bin/pip install --quiet --disable-pip-version-check "$$archive[bench]" && bin/python smoke.py bench) || exit 1; \
	done

# Whether this commit may be tagged and released: says what is missing.
release-check: dist $(VENV)/.bench
	$(BIN)/python -m tests.release_check

# The tests of a Ray cluster of two nodes on this machine, whose second node is killed in the middle.
ray: $(VENV)/.test
	$(PIP) --editable '.[test,ray]'
	$(BIN)/pytest --show-capture=no tests/execution/test_cluster.py

# The tests that need neither torch nor the source tree, with the oldest packages that pyproject.toml admits, or with
# the newest: make newest PYTHON=python3.13
lowest: RESOLUTION := lowest-direct
newest: RESOLUTION := highest
lowest newest:
	$(PYTHON) -m venv --clear $(VENV)-$@
	$(VENV)-$@/bin/pip install --quiet --disable-pip-version-check uv
	$(VENV)-$@/bin/uv pip install --quiet --python $(VENV)-$@/bin/python --resolution $(RESOLUTION) \
		--editable '.[bench]' 'hypothesis>=6.100' 'pytest>=8.3' 'pytest-xdist>=3.6'
	$(VENV)-$@/bin/pytest --numprocesses auto --dist worksteal \
		--ignore tests/test_docs.py --ignore tests/test_examples.py --ignore tests/test_porch.py

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("ptne_env needs Python 3.11 or newer, $(PYTHON) is " + sys.version.split()[0] + "; set PYTHON=...") if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)

# One stamp per extra that `make` installs.
$(VENV)/.bench $(VENV)/.docs $(VENV)/.test: $(VENV)/.%: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo 'Installing the extra "$*" in $(VENV)'
	$(PIP) --editable '.[$*]'
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-* $(OUT) dist
