PYTHON ?= python3
python := .venv/bin/python
node_modules := tests/node/node_modules viewer/node_modules
npm := $(if $(shell command -v npm),npm --prefix viewer --silent,@echo no npm here, the page is not checked:)
pytest := $(python) -m pytest -n 3 --dist=loadfile
protoc = $(python) -m grpc_tools.protoc --proto_path=proto $(wildcard proto/carla_recap/v1/*.proto)
generated := src/carla_recap/v1
durations := benchmarks/durations.txt
demo_extras := sim,video,foxglove

.PHONY: help venv test durations lint types proto check-proto bundle models wheel check nuscenes clients docs bench performance soak search demo clean

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: .venv/stamp ## Make .venv with everything a developer needs

test: venv $(node_modules) ## Run the whole test suite
	$(pytest)
	$(npm) test

durations: venv $(node_modules) ## Run the whole test suite, and keep its slowest tests in benchmarks/durations.txt
	$(python) -c 'from benchmarks.results import *; print(*vars(current_conditions()).values(), sep=", ")' >$(durations)
	$(pytest) --durations=50 | tee /dev/stderr | sed -n '/slowest/,$$p' >>$(durations)

lint: venv viewer/node_modules ## Check style, format, and which modules import which
	$(python) -m ruff check
	$(python) -m ruff format --check
	.venv/bin/lint-imports --no-cache --no-logo
	$(npm) run lint

types: venv viewer/node_modules ## Check types
	$(python) -m mypy
	$(npm) run types

proto: venv ## Regenerate the Python of the schemas
	rm -f $(generated)/*_pb2.py $(generated)/*_pb2.pyi
	$(protoc) --python_out=src --pyi_out=src

check-proto: venv ## Check that the Python of the schemas is up to date
	@rm -rf build/proto && mkdir -p build/proto
	$(protoc) --python_out=build/proto --pyi_out=build/proto
	@diff -r -x __init__.py -x __pycache__ build/proto/carla_recap/v1 $(generated) || \
		{ echo "$(generated) is not what proto/ generates: run 'make proto' and commit the result" >&2; exit 1; }

bundle: viewer/node_modules ## Bundle the script of the incident page, viewer/page/page.js, of viewer/source
	npm --prefix viewer run --silent bundle

models: venv ## Make the models of actors, in viewer/models, of tools/models
	$(python) -m tools.models

wheel: venv ## Build the wheel and try it in an empty environment
	PYTHON=$(python) tools/check-wheel

check: lint types check-proto wheel ## Everything but the tests

nuscenes: build/nuscenes/stamp ## Install nuscenes-devkit, which reads datasets in tests, into build/nuscenes

clients: build/clients/stamp ## Install CARLA's clients of other releases, with which tests talk to the server, into build/clients

docs: venv ## Build the documentation as a site, in build/site, and check its links
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --quiet
	$(python) tools/check-site

bench: venv ## Measure speed and sizes, and print them
	$(python) -m benchmarks

performance: venv ## Measure speed and sizes, and write docs/performance.md of them
	$(python) -m benchmarks --markdown

soak: venv ## Run a server with clients for half an hour, and check that nothing leaks, hangs or is left over
	$(python) -m benchmarks.soak

search: venv ## Try 10,000 random sequences of world operations, for crashes and for damage to the physics space
	@mkdir -p build
	$(python) -uX faulthandler -m tests.sim.sequences 10000 random > build/operations.txt

demo: $(if $(shell test .venv/stamp -nt pyproject.toml && echo yes),venv,.venv/demo-stamp) ## Simulate and record a crash, query it, film it, and make its incident page
	PATH="$(CURDIR)/.venv/bin:$$PATH" samples/demo.sh

clean: ## Remove everything that the other targets make
	rm -rf .venv build dist $(node_modules) .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

# Both targets install into .venv: the demo what it needs, the other all that a developer needs. An environment without a
# working pip is what is left of an interrupted start, or of a Python that is gone: it is made anew.
define install
	@$(python) -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear .venv
	$(python) -m pip install --quiet --editable '.[$(1)]'
	@touch $@
endef

.venv/stamp: pyproject.toml
	@echo 'Installing carla-recap and all tools into .venv: some minutes.'
	$(call install,dev)

.venv/demo-stamp: pyproject.toml
	@echo 'Installing carla-recap with the simulator and videos into .venv: about 115 MB to download.'
	$(call install,$(demo_extras))

# It needs an older numpy than the rest.
build/nuscenes/stamp:
	@echo 'Installing nuscenes-devkit into build/nuscenes: about 560 MB.'
	$(PYTHON) -m venv --clear build/nuscenes
	build/nuscenes/bin/python -m pip install --quiet 'nuscenes-devkit>=1.2,<2'
	@touch $@

# With the package, too: captures are tested with each client.
build/clients/stamp: pyproject.toml
	@echo "Installing CARLA's clients 0.9.15 and 0.10.0 into build/clients: about 150 MB to download."
	for release in 0-9-15 0-10-0; do \
		$(PYTHON) -m venv --clear build/clients/$$release && \
		build/clients/$$release/bin/python -m pip install --quiet carla-$$release --editable '.[server]' || exit; done
	@touch $@

$(node_modules): %/node_modules: %/package-lock.json
	@if command -v npm >/dev/null; \
		then npm ci --prefix $* --ignore-scripts --no-audit --no-fund && touch $@; \
		else echo 'no npm here: the checks that need $@ will be skipped'; fi
