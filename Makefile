# A fresh machine needs python3 (3.10 or newer, with venv) and make; everything else is made in .venv.
PYTHON ?= python3
# The tests need PyTorch; any build will do, so a smaller CPU build can be named here.
TORCH ?= torch==2.13.0
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest
# What was compiled once is kept: the tests start many processes, each of which would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo serve test test-long coverage check adapters lowest python $(PYTHONS) mutants verify bench bench-server bench-training bench-planners bench-peers bench-agents bench-unseen bench-ablations bench-dashboard evidence docs-data screenshots image image-check space format clean bench-install wheels-check docs features bench-capacity bench-cluster
.DEFAULT_GOAL := demo

$(VENV)/.base: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or newer is needed; try: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
# The package's former name: were both installed, removing the old one would take the commands of the new one away.
	$(BIN)/python -m pip uninstall --quiet --quiet --yes drone-env
	rm -rf drone_env.egg-info
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.server: $(VENV)/.base
	$(BIN)/python -m pip install --quiet --editable '.[server]'
	touch $@

# PyTorch by pip, which knows of builds that lie on this machine; then the rest by uv, which takes what it finds installed.
$(VENV)/.dev: $(VENV)/.base
	@date +%s >$(VENV)/began
	$(BIN)/python -m pip install --quiet --no-compile $(TORCH) 'uv>=0.9'
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[dev]'
	@echo "Development tools installed in $$(($$(date +%s) - $$(cat $(VENV)/began))) s"
	touch $@

# Fly a network that plans, compare the agents on the standard and skyline tasks, draw one flight.
demo: $(VENV)/.base
	@echo "== One mission: a network that plans, over skyline_medium map 7 =="
	@$(BIN)/drone-env fly --task skyline_medium --agent tournet --seed 7 --picture demo/mission.png
	@echo
	@echo "== 100 test maps of each standard and skyline task =="
	@$(BIN)/drone-env evaluate --task easy medium hard --agents random greedy pathqnet optimal --split test --episodes 100
	@$(BIN)/drone-env evaluate --task skyline_easy skyline_medium skyline_hard --agents random greedy tournet optimal --split test --episodes 100
	@echo
	@echo "To watch and fly in the browser: make serve, then open http://127.0.0.1:8000"

# The server with its page, until Ctrl-C; make serve ARGS="--port 9000".
serve: $(VENV)/.server
	@$(BIN)/drone-env serve $(ARGS)

# Every behaviour; what is marked long is left to test-long.
test: $(VENV)/.dev
	$(PYTEST) -n auto --dist worksteal

# What is marked long. One Ray cluster serves all tests that need one, so that they run one after another.
test-long: $(VENV)/.dev
	$(PYTEST) -m long -n auto --dist worksteal --ignore tests/cluster
	$(PYTEST) -m long tests/cluster

# What was promised, feature by feature, and whether its tests pass.
features: $(VENV)/.dev
	$(PYTEST) -q -n auto --features

# All tests, with a report of the lines that none of them runs: htmlcov/index.html. Compiled code is not counted.
coverage: $(VENV)/.dev
	$(PYTEST) -m '' -n auto --dist worksteal --ignore tests/cluster --cov --cov-report=
	$(PYTEST) -m '' tests/cluster --cov --cov-append --cov-fail-under=93 --cov-report=term:skip-covered --cov-report=html

# Lint, formatting, types.
check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# What needs TRL, Inspect, TorchRL, RLlib or MoviePy, in an environment of its own.
ADAPTERS := $(VENV)/adapters
$(ADAPTERS)/.made: Makefile $(VENV)/.dev
	test -x $(ADAPTERS)/bin/python || $(PYTHON) -m venv $(ADAPTERS)
	$(ADAPTERS)/bin/python -m pip install --quiet --no-compile $(TORCH)
	$(BIN)/uv pip install --quiet --python $(ADAPTERS)/bin/python --editable '.[inspect,trl,video]' 'moviepy>=2' 'ray[rllib]>=2.60' 'stable-baselines3>=2.7' 'torchrl>=0.14' 'pytest>=8.3' 'pytest-timeout>=2.3'
	touch $@

adapters: $(ADAPTERS)/.made
	$(ADAPTERS)/bin/python -m pytest tests/adapters

# The tests with the oldest version of each dependency that pyproject.toml allows (but for PyTorch); old ones may warn.
LOWEST := $(VENV)/lowest
$(LOWEST)/.made: $(VENV)/.dev
	test -x $(LOWEST)/bin/python || $(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --no-compile $(TORCH)
	$(BIN)/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --editable '.[dev]'
	touch $@

lowest: $(LOWEST)/.made
	$(LOWEST)/bin/python -m pytest -W default -n auto --dist worksteal

# Tests on the lowest and the highest Python, without PyTorch: those that need it are skipped. llm, parity and property
# would take CI over its five minutes for them; the other folders need a browser, a cluster or programs of this Python.
PYTHONS := python-3.10 python-3.13
python: $(PYTHONS)
$(PYTHONS): python-%: $(VENV)/.dev
	python=$$($(BIN)/python -m tests.tools $*) && $$python -m venv $(VENV)/$*
	$(BIN)/uv pip install --quiet --python $(VENV)/$*/bin/python --editable '.[llm,server,test]'
	env -u DRONE_ENV_REQUIRE_TOOLS $(VENV)/$*/bin/python -m pytest -n auto --dist worksteal $(addprefix --ignore tests/,browser cluster container docs llm package parity property)

# Deliberate faults, one at a time: does a test of `make test` notice each?
mutants: $(VENV)/.dev
	$(BIN)/python tools/mutants.py $(ARGS)

# The campaigns: the same properties over many more cases, other Pythons, oldest dependencies, faults; takes hours.
OTHER_PYTHON ?= python3.13
verify: $(VENV)/.dev
	DRONE_ENV_EXAMPLES=30000 DRONE_ENV_PARITY_STEPS=100000000 $(PYTEST) -m '' -n auto --timeout 36000 tests/property tests/parity tests/unit/test_exact.py tests/unit/test_legs.py tests/unit/test_store_processes.py tests/unit/test_training_run.py tests/unit/test_network.py
	DRONE_ENV_MUTATIONS=2500 $(PYTEST) --timeout 36000 tests/unit/test_city_mutations.py
	DRONE_ENV_KILLS=100 DRONE_ENV_FRAMES=20000 DRONE_ENV_SOCKET_STEPS=1000000 DRONE_ENV_SCHEMA_EXAMPLES=200 $(PYTEST) -m '' --timeout 36000 tests/api
	$(BIN)/python tests/api/hostile_callers.py
	DRONE_ENV_KILLS=50 DRONE_ENV_LLM_MAPS=100 DRONE_ENV_LLM_ROUTES=100 $(PYTEST) -m '' --timeout 36000 tests/llm
	DRONE_ENV_NGINX_SESSIONS=150 $(PYTEST) --timeout 36000 tests/cluster/test_nginx.py
	$(MAKE) coverage mutants adapters wheels-check lowest
	$(MAKE) test VENV=$(VENV)/$(OTHER_PYTHON) PYTHON=$(OTHER_PYTHON)

# The simulator, batched and alone, beside its peers, in an environment of its own; make bench ARGS=--quick for a short run.
bench: $(VENV)/.base
	$(BIN)/python benchmarks/simulator.py $(ARGS)

# The server's WebSocket beside OpenEnv's echo environment.
bench-server: $(VENV)/.dev
	$(BIN)/python benchmarks/server.py $(ARGS)

# The trainer beside Stable-Baselines3's DQN; takes half an hour.
bench-training: $(VENV)/.dev
	$(BIN)/python benchmarks/training.py $(ARGS)

# What the planners take for a map, and the value of a decision; a minute.
bench-planners: $(VENV)/.base
	$(BIN)/python benchmarks/planners.py $(ARGS)

# PPO and MaskablePPO on skyline, 13 minutes of CPU time for each of six runs; ARGS="--cpu-seconds 300" for less.
bench-peers: $(VENV)/.dev
	$(BIN)/python benchmarks/peers.py $(ARGS)

# Decisions that each agent makes in a second of one core, beside its share of the optimum.
bench-agents: $(VENV)/.dev
	$(BIN)/python benchmarks/agents.py $(ARGS)

# The tour network on tasks of sizes that it was never trained on.
bench-unseen: $(VENV)/.dev
	$(BIN)/python benchmarks/unseen.py $(ARGS)

# What each part of the tour network's recipe is worth; half an hour, and goes on where it was stopped.
bench-ablations: $(VENV)/.dev
	$(BIN)/python benchmarks/ablations.py $(ARGS)

# Frames, first paint and weight of the dashboard, in the system's chromium.
bench-dashboard: $(VENV)/.dev
	$(BIN)/python benchmarks/dashboard.py $(ARGS)

# Seconds and megabytes from an empty environment to the first flight; the dependencies of the project's first version
# beside it, resolved and not installed.
bench-install: $(VENV)/.dev
	$(BIN)/python benchmarks/install.py $(ARGS)

# Source distribution and wheel in empty environments of each Python, with server and page; make wheels-check ARGS='--python 3.12'.
wheels-check: $(VENV)/.dev
	$(BIN)/python tests/package/installed.py $(ARGS)

# What a session and a step cost the server, its store and nginx; some minutes, and needs nginx.
bench-capacity: $(VENV)/.dev
	$(BIN)/python benchmarks/capacity.py $(ARGS)

# Evaluation on a Ray cluster of several nodes on this machine beside the plain run; ARGS="--maps 100000" for all.
bench-cluster: $(VENV)/.dev
	$(BIN)/python benchmarks/cluster.py $(ARGS)

# Train all standard tasks with three seeds each and fly the test maps; takes an hour, and goes on where it was stopped.
evidence: $(VENV)/.dev
	$(BIN)/python benchmarks/training_runs.py $(ARGS)

# The documentation as a site in build/site. (The variable silences what its theme prints about itself.)
docs: $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# The generated pages, tables and pictures of docs/, the table of README, and what the notebook puts out; takes half an
# hour. What an agent costs is measured on one core. ARGS=tasks for what the agents reach alone.
docs-data: $(VENV)/.dev
	$(BIN)/python tools/docs_tables.py
	$(BIN)/python tools/docs_notebook.py
	$(BIN)/python tools/docs_generate.py $(ARGS)

# The pictures of the dashboard in docs/images, taken in the system's chromium.
screenshots: $(VENV)/.dev
	$(BIN)/python tools/docs_screenshots.py

# Build the container and record it in data/docker_build.log; BUILDER=podman or buildah, ARGS for more of its options.
BUILDER ?= docker
image: $(VENV)/.base
	$(BIN)/python tools/build_image.py --builder $(BUILDER) $(ARGS)

# Build it and prove that it works: hardened, restarted, stopped, flown; docker or podman.
image-check: $(VENV)/.dev
	$(BIN)/python tools/check_image.py --builder $(BUILDER) $(ARGS)

# Stage the folder that becomes a Hugging Face Space, in build/space.
space: $(VENV)/.base
	$(BIN)/python tools/stage_space.py $(ARGS)

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv build dist demo htmlcov .coverage .coverage.* .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
