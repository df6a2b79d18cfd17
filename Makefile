# Everything runs in .venv, which `make setup` builds. Nothing else is needed but python3 >= 3.11 with venv.

PYTHON ?= python3
# Processes that run the tests; each takes up to 3 GB. `make test TEST_PROCESSES=0` runs them one after the other.
TEST_PROCESSES ?= auto
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/setup-done
CODE := src tests benchmarks examples web
BUNDLE := src/semscape/web/digest.txt
WEB_SOURCES := $(shell find web/src -type f) web/package-lock.json web/bundle_web.py

.PHONY: help setup web web-check demo test lint examples accuracy benchmark docs-pictures docs-experiments simulator-realism \
	simulator-speed slurm motion clean

help:
	@echo "make demo           simulate a specimen, reconstruct it, and say where the report is"
	@echo "make test           the whole test suite"
	@echo "make setup          only build .venv (the others do so where it is needed)"
	@echo "make web            bundle web/src into the package again, after a change"
	@echo "make web-check      types of web/src; installs what the tests in a browser need"
	@echo "make lint           style and types"
	@echo "make examples       run the scripts of examples/ on a small simulated series"
	@echo "make slurm          a batch through a real SLURM of one node; installs it (Debian, as root) where it is missing"
	@echo "make accuracy       accuracy on real and simulated series, as JSON"
	@echo "make benchmark      seconds per stage, of measuring and matching, peak memory, tilt correction, as JSON"
	@echo "make motion         the motion stage alone: accuracy, coverage, speed, repeatability; writes docs/motion.md"
	@echo "make simulator-realism  simulated beside measured series: the table of docs/simulator.md"
	@echo "make simulator-speed    seconds per simulated view, as JSON"
	@echo "make docs-pictures  draw the pictures of docs/ again"
	@echo "make docs-experiments  run every experiment and write docs/experiments.md"
	@echo "make clean          remove .venv, caches and the demo"

setup: $(STAMP)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "semscape needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
		"Name another one: make PYTHON=python3.12 $(or $(MAKECMDGOALS),setup)" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "$(PYTHON) comes without venv; install it (on Debian and Ubuntu: apt install python3-venv)" >&2; exit 1; }
	@echo "setting up $(VENV) (once; a few minutes)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	@touch $(STAMP)

# Setting up has bundled the web parts; this is for later changes of them.
$(BUNDLE): $(WEB_SOURCES) | $(STAMP)
	@$(BIN)/python web/bundle_web.py
	@touch $(BUNDLE)

web: $(BUNDLE)

# TypeScript's own check; esbuild only strips the types. It also installs what the tests in a browser need.
web-check: $(STAMP)
	@$(BIN)/python web/bundle_web.py check

demo: $(STAMP) $(BUNDLE)
	@$(BIN)/semscape demo --output demo

test: $(STAMP) $(BUNDLE)
	@$(BIN)/python -m pytest --numprocesses $(TEST_PROCESSES) --maxprocesses 4 --dist worksteal

lint: $(STAMP)
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/mypy

examples: $(STAMP)
	@for script in examples/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

slurm: $(STAMP)
	@tests/batch/slurm_cluster.sh install
	@SEMSCAPE_CI_SLURM=1 $(BIN)/python -m pytest tests/batch/test_slurm.py

accuracy: $(STAMP)
	@$(BIN)/python benchmarks/accuracy.py

benchmark: $(STAMP)
	@$(BIN)/python benchmarks/speed.py
	@$(BIN)/python benchmarks/metrology.py
	@$(BIN)/python benchmarks/tilt_correction.py
	@$(BIN)/python benchmarks/matching.py
	@$(BIN)/python benchmarks/robust_speed.py

motion: $(STAMP)
	@$(BIN)/python benchmarks/motion.py > .motion.json
	@$(BIN)/python benchmarks/motion_tables.py .motion.json > docs/motion.md
	@rm -f .motion.json

simulator-realism: $(STAMP)
	@$(BIN)/python benchmarks/simulator_realism.py

simulator-speed: $(STAMP)
	@$(BIN)/python benchmarks/simulator_speed.py

docs-pictures: $(STAMP)
	@$(BIN)/python benchmarks/docs_pictures.py
	@$(BIN)/python benchmarks/app_pictures.py

# With the measured sets where they lie beside the repository, as in the tests.
docs-experiments: $(STAMP)
	@$(BIN)/semscape experiments all --output docs $(addprefix --data ,$(wildcard $(or $(SEMSCAPE_SHARED_DATA),../shared/data)))
	@rm -f docs/experiments.html

clean:
	rm -rf web/node_modules src/semscape/web
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis build dist demo
	find src tests benchmarks examples -depth -name __pycache__ -exec rm -rf {} +
	find src -depth -name '*.egg-info' -exec rm -rf {} +
