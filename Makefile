# make demo | quick | test | test-part | test-all | record | coverage | lint | docs | notebooks | bench | release-check | clean; each sets up what it needs. PYTHON=python3.12 picks another one.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMPS := $(VENV)/.stamps
CHECK  := from mistray._llvm import find_llvm; from mistray._mitsuba_compat import import_mitsuba; \
          llvm = find_llvm(); import_mitsuba(); print(llvm)

# A worker that dies ends the run: xdist waits for ever for the tests of one that it replaces
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart=0

# Where mistray meets what it needs
LOWEST := tests/physics tests/scene tests/trace tests/cache tests/cluster tests/mechanics tests/analyses

.DEFAULT_GOAL := help
.PHONY: help demo quick test test-part test-all test-lowest record coverage lint docs notebooks bench release-check venv clean
.DELETE_ON_ERROR:

help:
	@echo "make demo      trace the ghosts of the phone camera into out/demo"
	@echo "make quick     a test of every room, within a minute"
	@echo "make test      lint, types and tests, in about six minutes"
	@echo "make test-part what make test leaves out, in parts: that of the day, or: make test-part MISTRAY_PART=2"
	@echo "make test-all  lint, types and all tests"
	@echo "make record    run all but the slow tests, and write down what each takes"
	@echo "make coverage  lines that the tests of make test reach"
	@echo "make test-lowest quick tests with the lowest versions of what mistray needs"
	@echo "make lint      lint and types only"
	@echo "make docs      build the documentation site into out/docs; open out/docs/index.html"
	@echo "make notebooks open the notebooks in JupyterLab; its options: make notebooks JUPYTER='--no-browser --allow-root'"
	@echo "make bench     measure the speed beside other programs; parts: make bench BENCH='--only batoid embree'"
	@echo "make release-check build and check a release, and list what only the owner can fill in"
	@echo "make venv      only set up $(VENV)"
	@echo "make clean     remove $(VENV), other environments, caches and results"

demo: venv
	$(BIN)/mistray ghosts scenes/phone_camera/scene.xml --field-deg 0 5 10 15 20 25 27 --rays 2e4 --out out/demo --force

# Only files with such tests are read
quick: venv
	$(PYTEST) -m "quick and not (gpu or slow or long)" $$(grep -rl 'mark\.quick' tests --include='test_*.py')

test: lint
	$(PYTEST) -m "not (gpu or slow or long)"

# The tests of tests/durations.json in parts of about equal length
test-part: venv
	MISTRAY_PART=$${MISTRAY_PART:-$$(($$(date +%s) / 86400))} $(PYTEST) -m "long and not (gpu or slow)"

test-all: lint
	$(PYTEST) -m "not gpu"

# What the tests take, by which they are put into tiers
record: venv
	MISTRAY_RECORD=1 $(PYTEST) -m "not (gpu or slow)"

# Lines that the tests of make test reach, commands that they start included: pyproject.toml says how many it must be
coverage: venv
	rm -rf out/coverage && mkdir -p out/coverage
	$(BIN)/python -m coverage run $(filter-out $(BIN)/python,$(PYTEST)) -m "not (gpu or slow or long)"
	$(BIN)/python -m coverage combine -q && $(BIN)/python -m coverage report

# In an environment of its own, with all extras of users but JupyterLab; old Matplotlib calls what new pyparsing has deprecated
test-lowest: venv
	$(PYTHON) -m venv .venv-lowest
	$(BIN)/python tests/lowest.py > .venv-lowest/lowest.txt
	.venv-lowest/bin/python -m pip install -qq -c .venv-lowest/lowest.txt \
	  -e '.[batoid,cad,distributed,images,nlopt,pdf,tables,view,widget,xarray]' pytest pytest-timeout pytest-xdist tmm
	.venv-lowest/bin/python -m pytest -W ignore::DeprecationWarning -m "quick and not (gpu or slow or long)" $(LOWEST)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy $$(find mistray -name '*.pyi' | sed 's/i$$//')

# Notebooks and pictures first, where their code has changed; the theme announces its successor at each build
docs: venv
	$(BIN)/python docs/site/notebook_results.py
	$(BIN)/python docs/site/make_pictures.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "open out/docs/index.html"

# The kernel called python3 is that of the environment
notebooks: venv $(STAMPS)/notebooks
	$(BIN)/jupyter-lab --notebook-dir=notebooks $(JUPYTER)

bench: venv $(STAMPS)/peers
	$(BIN)/python benchmarks/bench.py $(BENCH)

# Its tools need other versions than the tests, so they have an environment of their own
release-check:
	$(PYTHON) -m venv .venv-release
	.venv-release/bin/python -m pip install -qq 'pip>=25.1'
	.venv-release/bin/python -m pip install -qq --group release
	.venv-release/bin/python .ci/release_check.py

venv: $(STAMPS)/installed $(STAMPS)/libraries

clean:
	rm -rf $(VENV) .venv-lowest .venv-release .nox out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find mistray plugins scenes tests benchmarks -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

$(STAMPS)/created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "mistray needs Python 3.11 or newer as '$(PYTHON)'; name another with: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	  package=python$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv; \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing $$package" && apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$package >/dev/null; \
	  else echo "'$(PYTHON)' cannot make virtual environments; install $$package" >&2; exit 1; fi; }
	@echo "making $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@mkdir -p $(STAMPS) && touch $@

PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-input --prefer-binary

# The programs that tests compare with come without what their windows need
$(STAMPS)/installed: pyproject.toml tests/peers.txt | $(STAMPS)/created
	@echo "installing mistray and its dependencies into $(VENV) (minutes the first time)"
	@$(PIP) 'pip>=25.1' # the first that knows groups
	@$(PIP) -e . --group dev
	@$(PIP) --no-deps -r tests/peers.txt
	@touch $@

# Programs that only the benchmarks compare with
$(STAMPS)/peers: $(STAMPS)/installed
	@$(PIP) --group bench
	@touch $@

$(STAMPS)/notebooks: $(STAMPS)/installed
	@echo "installing JupyterLab into $(VENV)"
	@$(PIP) -e '.[notebooks]'
	@touch $@

# Dr.Jit opens libLLVM, which pip brings by an extra only. LLVM 19 is the version the measurements were made with.
$(STAMPS)/libraries: | $(STAMPS)/installed
	@if ! $(BIN)/python -c '$(CHECK)' >/dev/null 2>&1; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq; \
	    names=$$(apt-cache pkgnames libllvm | grep -E '^libllvm(1[7-9]|2[0-3])(t64)?$$' | sort -rV); \
	    llvm=$$(echo "$$names" | grep -x libllvm19 || echo "$$names" | head -n 1); \
	    echo "installing $$llvm libatomic1"; \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$llvm libatomic1 >/dev/null; \
	  else echo "installing the extra llvm into $(VENV)"; $(PIP) -e '.[llvm]'; fi; fi
	@line=$$($(BIN)/python -c '$(CHECK)' 2>&1 | tail -n 1); \
	  echo "$$line" | sed 's/^[A-Za-z.]*Error: //'; case "$$line" in LLVM*) ;; *) exit 1 ;; esac
	@touch $@
