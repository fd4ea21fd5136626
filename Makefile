# Everything runs in .venv, made on first use; `make help` lists the targets.
# On a machine where `python3` is older than 3.11: make test PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
EVOGS := $(VENV)/bin/evogs
PIP := $(PY) -m pip install --quiet --disable-pip-version-check -c constraints.txt
RUNTIME := $(VENV)/.installed-runtime
TEST := $(VENV)/.installed-test
DEV := $(VENV)/.installed-dev
# A worker for each core; threads of one test do not take the core of another. Bytecode is
# kept, even where the environment says otherwise: tests start some hundred processes. Files go to
# the workers in the order of tests/conftest.py.
PYTEST := PYTHONDONTWRITEBYTECODE= NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
  $(PY) -m pytest -n auto --dist loadfile --no-loadscope-reorder
FIRST_RING := $(PYTEST) -m "not thorough and not slow" --hypothesis-profile seeded
WEB := tools/web
PEERS := tests/codec/io/peers
INPUTS := pyproject.toml constraints.txt

DEMO_LEVELS := 0 1 2 3 4 5
DEMO_SPLATS := 40000

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: dist docs help venv demo picture test test-all test-rest test-slow test-peers check lint generated conformance fuzz format bench web test-web clean

help:
	@echo "make demo       encode, decode, extract and draw the scene that ships with the project"
	@echo "make test       the first ring of tests: four minutes on two cores, without torch"
	@echo "make test-all   every test that CI runs, with random examples; installs torch"
	@echo "make test-rest  what is left of test-all after test, as CI runs it"
	@echo "make test-slow  tests that take minutes each; CI does not run them"
	@echo "make test-peers  files of other programs, in and out; installs those of npm; needs Node 20"
	@echo "make check      formatting, lint, types, the first ring, generated files"
	@echo "make lint       formatting and lint alone, as CI runs them"
	@echo "make conformance  the suite on the reference decoder, on the one written from the text, on itself"
	@echo "make fuzz       100,000 streams, codec against oracle (an hour)"
	@echo "make format     reformat and fix what ruff can fix"
	@echo "make bench      the figures of docs/figures.md; BENCH='--ply SCENE.ply' for another scene"
	@echo "make picture    the moving picture of the README, docs/figures/stream.gif"
	@echo "make web        the decoder for browsers, and the page of evogs view; needs Node 18"
	@echo "make test-web   tests of tools/web, with Chromium if it is there"
	@echo "make docs       the pages as a site, in build/site"
	@echo "make dist       wheel and source distribution in dist/, as an index takes them"
	@echo "make venv       only set up .venv"
	@echo "make clean      remove .venv, build and caches"

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else \
	  "evogs needs Python 3.11 or later: make PYTHON=python3.12 " + "(this is " + sys.version + ")")'
	$(PYTHON) -m venv $(VENV)

# The stamps are files, so the installation runs once and again when its inputs change.
$(RUNTIME): $(INPUTS) | $(PY)
	$(PIP) -e '.[render]'
	@touch $@

$(TEST): $(INPUTS) | $(PY)
	$(PIP) -e '.[render,test]'
	@touch $(RUNTIME) $@

$(DEV): $(INPUTS) | $(PY)
	$(PIP) -e '.[dev]'
	@touch $(RUNTIME) $(TEST) $@

venv: $(DEV)

demo: $(RUNTIME)
	@mkdir -p build
	$(PY) -m evogs_codec.render.demo_scene build/demo.ply --splats $(DEMO_SPLATS) \
	  --cameras build/demo-cameras.json
	$(EVOGS) encode build/demo.ply build/demo.evogs
	$(EVOGS) validate build/demo.evogs
	$(EVOGS) info build/demo.evogs
	@set -e; for k in $(DEMO_LEVELS); do \
	  $(EVOGS) extract build/demo.evogs build/demo-L$$k.evogs --level $$k; \
	  $(EVOGS) decode build/demo-L$$k.evogs build/demo-L$$k.ply; \
	done
	$(EVOGS) render build/demo.evogs build/demo.png --force --sheet --size 400 \
	  --camera build/demo-cameras.json --reference build/demo.ply
	@set -e; bytes() { wc -c < "$$1" | tr -d ' '; }; \
	splats() { LC_ALL=C sed -n 's/^element vertex //p; /^end_header/q' "$$1"; }; \
	echo; echo "What came out (build/):"; \
	printf '%-16s %8s %13s %13s\n' level splats '.evogs bytes' '.ply bytes'; \
	for k in $(DEMO_LEVELS); do \
	  printf '%-16s %8s %13s %13s\n' "demo-L$$k" "$$(splats build/demo-L$$k.ply)" \
	    "$$(bytes build/demo-L$$k.evogs)" "$$(bytes build/demo-L$$k.ply)"; \
	done; \
	printf '%-16s %8s %13s %13s\n' 'demo (original)' "$$(splats build/demo.ply)" \
	  "$$(bytes build/demo.evogs)" "$$(bytes build/demo.ply)"; \
	echo; echo "build/demo.png shows every level and the original, with splats, bytes and PSNR."; \
	echo "To see it stream: $(EVOGS) view build/demo.evogs"

test: $(TEST)
	$(FIRST_RING)

test-all: $(DEV)
	$(PYTEST) -m "not slow" --hypothesis-profile random

# What is left of test-all after `make test`: other tests, and other random examples.
test-rest: $(DEV)
	$(PYTEST) -m "(thorough or hypothesis or random) and not slow" --hypothesis-profile random

test-slow: $(DEV)
	$(PYTEST) -m slow

# Without their install scripts, which fetch what these tests do not run.
test-peers: $(DEV)
	cd $(PEERS) && npm ci --no-audit --no-fund --ignore-scripts
	$(PYTEST) tests/codec/io/test_interchange_peers.py tests/codec/io/test_interchange_viewers.py

check: lint
	$(PY) -m mypy
	$(FIRST_RING)
	$(MAKE) generated

lint: $(DEV)
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .

# That the vectors are those of their recipes is a test of `make test-all`.
generated: $(DEV)
	$(PY) -m tools.spec_tables --check
	$(PY) -m conformance.renders generate --check

# The suite in full, on the reference decoder and on itself. The last command tries the mutants: 24
# minutes of processor time, by two processes.
conformance: $(DEV)
	$(EVOGS) conformance run --decoder "$(PY) -m conformance.decoders.reference" --fresh 25
	$(EVOGS) conformance run --decoder "$(PY) conformance/decoders/cleanroom/decoder.py" --fresh 25
	$(EVOGS) conformance selftest
	$(PY) -m conformance.renders run --renderer "$(PY) -m conformance.renders reference"
	$(PY) -m conformance.generator --check

fuzz: $(DEV)
	$(PY) -m conformance.fuzzing --count 100000 --jobs 2 --keep build/findings

format: $(DEV)
	$(PY) -m ruff format .
	$(PY) -m ruff check --fix .

bench: $(DEV)
	$(PIP) -e '.[bench,render]'
	$(PY) -m tools.bench $(BENCH)

# The picture shows coarse levels after --refine, which takes a minute.
picture: $(DEV)
	@mkdir -p build
	$(PY) -m evogs_codec.render.demo_scene build/demo.ply --splats $(DEMO_SPLATS) \
	  --cameras build/demo-cameras.json
	$(EVOGS) encode build/demo.ply build/refined.evogs --refine
	$(PY) -m tools.stream_picture build/refined.evogs docs/figures/stream.gif \
	  --camera build/demo-cameras.json --reference build/demo.ply

$(WEB)/node_modules/.installed: $(WEB)/package-lock.json
	cd $(WEB) && npm ci --no-audit --no-fund
	@touch $@

# The page is in the tree, so that a checkout without Node has it: commit what this changes.
web: $(WEB)/node_modules/.installed
	cd $(WEB) && npm run build && npm run install-page --workspace viewer

# It builds without installing the page: a test compares the two. Streams that an earlier encoder
# made for the tests go first.
test-web: $(TEST)
	@rm -rf build/web-test
	@if ! command -v npm > /dev/null; then echo "skipped: tools/web needs Node 18 or later"; \
	else $(MAKE) $(WEB)/node_modules/.installed && cd $(WEB) && npm run build && npm run lint && npm test --ignore-scripts; fi

docs: $(RUNTIME)
	$(PIP) -e '.[docs]'
	$(PY) -m tools.site build/site
	@echo "open build/site/index.html"

dist: $(DEV)
	rm -rf dist build/lib build/bdist.*
	$(PY) -m build --outdir dist .
	$(PY) -m twine check --strict dist/*

clean:
	rm -rf $(WEB)/node_modules $(WEB)/*/dist $(PEERS)/node_modules
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
