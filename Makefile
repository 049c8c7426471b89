# `make demo` and `make test` do everything on a fresh machine with Python 3.11 to 3.14: see `make help`.
# Another interpreter: `make test PYTHON=python3.12`.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.installed
PYTHON :=
CANDIDATES := $(or $(PYTHON),python3 python3.13 python3.12 python3.11 python3.14 python)
SUITABLE := import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))

FUZZ_SECONDS := 600
FUZZ_TARGETS := cdr cloud csv mcap db3 bag metadata frames tum covariances results config upgrade scenario points

PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal

# one process per core is enough: no threads below it
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export MPLBACKEND := Agg
# what one process has compiled the hundreds that tests start need not compile
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test test-all fuzz properties check lint kernel docs bench results scenarios paper paper-quick clean

help: ## Show this list
	@sed -n 's/^\([a-z-]*\):.*## /\1: /p' Makefile | awk -F': ' '{ printf "  make %-11s %s\n", $$1, $$2 }'

demo: $(READY) ## Estimate a real drive, draw it and print how far it is from the reference
	@$(BIN)/holdfast demo

test: $(READY) ## Run the fast tests (ten to seventeen minutes on two cores)
	@$(PYTEST) -m "not slow"

test-all: $(READY) ## Run every test, those on whole recordings too
	@$(PYTEST)

fuzz: $(READY) ## Feed every decoder and the configuration with broken inputs: FUZZ_SECONDS each (600)
	@for target in $(FUZZ_TARGETS); do \
	    echo "fuzzing $$target for $(FUZZ_SECONDS) s"; \
	    $(BIN)/python tests/fuzz/fuzz.py $$target --seconds $(FUZZ_SECONDS) || exit 1; \
	done

properties: $(READY) ## Search at random for examples that break the property tests
	@HOLDFAST_FUZZ=1 $(PYTEST) $$(grep -rl --include='test_*.py' 'from hypothesis' tests)

check: lint test ## Run what must pass before a commit (linters and fast tests)

lint: $(READY) ## Check format, style, types and the direction of imports
	@$(BIN)/ruff format --check
	@$(BIN)/ruff check
	@$(BIN)/mypy
	@$(BIN)/lint-imports

kernel: $(READY) ## Compile the IMU path for this machine, once (it is done when it is needed, too)
	@$(BIN)/python -c "import holdfast; holdfast.RealtimeEstimator"

docs: $(READY) ## Build the documentation site: site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --clean
	@echo "written to site/index.html"

bench: $(READY) ## Measure speed on this machine
	@$(BIN)/holdfast bench

results: $(READY) ## Run the real drives and print their accuracy (about ten minutes)
	@$(BIN)/python benchmarks/real_drives.py

scenarios: $(READY) ## Run the simulated scenarios with ten seeds each and print the tables (long)
	@$(BIN)/python benchmarks/scenarios.py

paper-quick: $(READY) ## Compare with the paper's other systems on short recordings: paper/report.html
	@$(BIN)/holdfast paper -o paper --quick

paper: $(READY) ## The same with ten seeds of ten minutes (more than an hour): paper-full/report.html
	@$(BIN)/holdfast paper -o paper-full

clean: ## Remove the virtual environment and the caches, not the results
	@rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	@find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	@python=; for candidate in $(CANDIDATES); do \
	    if $$candidate -c '$(SUITABLE)' >/dev/null 2>&1; then python=$$candidate; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	    echo "error: no Python 3.11 to 3.14 with the venv module among: $(CANDIDATES)" \
	        "(Debian and Ubuntu: install python3-venv)" >&2; exit 1; \
	fi; \
	echo "Installing into $(VENV) with $$($$python --version) ..."; \
	rm -f $@; \
	{ { [ -x $(BIN)/pip ] && $(BIN)/python -c '$(SUITABLE)'; } || $$python -m venv --clear $(VENV); } \
	    && $(BIN)/python -m pip install --disable-pip-version-check --no-input \
	        -c constraints.txt -e ".[dev]" >$(VENV)/install.log 2>&1 \
	    || { cat $(VENV)/install.log >&2; echo "error: the installation into $(VENV) failed, see above" >&2; exit 1; }
	@touch $@
