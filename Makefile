# A fresh machine needs python3 (3.10 or newer, with venv) and make; everything else is made in .venv.
PYTHON ?= python3
# The tests need PyTorch; any build will do, so a smaller CPU build can be named here.
TORCH ?= torch==2.13.0
BIN := .venv/bin

.PHONY: demo test coverage check adapters verify bench bench-server bench-training bench-dashboard evidence docs-data screenshots image image-check space format clean bench-install wheels-check docs features bench-capacity bench-cluster
.DEFAULT_GOAL := demo

.venv/.base: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or newer is needed; try: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

# A current pip resolves so many packages faster; Python compiles what is imported, and the rest need never be.
.venv/.dev: .venv/.base
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile $(TORCH)
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[dev]'
	touch $@

# Fly the trained network, compare the agents on every task (no network is shipped for skyline), draw one mission.
demo: .venv/.base
	@echo "== One mission: the trained network over hard map 7 =="
	@$(BIN)/drone-env fly --task hard --agent pathqnet --seed 7 --picture demo/mission.png
	@echo
	@echo "== 100 test maps of each task =="
	@$(BIN)/drone-env evaluate --task easy medium hard --agents random greedy pathqnet optimal --split test --episodes 100
	@$(BIN)/drone-env evaluate --task skyline_easy skyline_medium skyline_hard --split test --episodes 100

test: .venv/.dev
	$(BIN)/python -m pytest -n auto --dist worksteal

# What was promised, feature by feature, and whether its tests pass.
features: .venv/.dev
	$(BIN)/python -m pytest -q -n auto --dist loadfile --features

# The tests once more, with a report of the lines that none of them runs: htmlcov/index.html. Compiled code is not counted.
coverage: .venv/.dev
	$(BIN)/python -m pytest -n auto --dist worksteal --cov --cov-fail-under=90 --cov-report=term:skip-covered --cov-report=html

# Lint, formatting, types.
check: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# What needs TRL and Inspect, in an environment of its own.
.venv-adapters/.made: pyproject.toml
	test -x .venv-adapters/bin/python || $(PYTHON) -m venv .venv-adapters
	.venv-adapters/bin/python -m pip install --quiet $(TORCH)
	.venv-adapters/bin/python -m pip install --quiet --editable '.[inspect,trl]' 'pytest>=8.3' 'pytest-timeout>=2.3'
	touch $@

adapters: .venv-adapters/.made
	.venv-adapters/bin/python -m pytest tests/llm/test_inspect.py tests/llm/test_trl.py

# The same properties over many more cases; takes long.
verify: .venv/.dev
	DRONE_ENV_EXAMPLES=30000 DRONE_ENV_PARITY_STEPS=100000000 $(BIN)/python -m pytest -n auto --timeout 36000 tests/property tests/parity tests/unit/test_exact.py tests/unit/test_store_processes.py tests/unit/test_rl.py
	DRONE_ENV_KILLS=100 DRONE_ENV_FRAMES=20000 DRONE_ENV_SOCKET_STEPS=1000000 DRONE_ENV_SCHEMA_EXAMPLES=200 $(BIN)/python -m pytest --timeout 36000 tests/api
	DRONE_ENV_KILLS=50 DRONE_ENV_LATENCY=0.2 DRONE_ENV_LLM_MAPS=100 $(BIN)/python -m pytest --timeout 36000 tests/llm

# The batched simulator beside its peers, in an environment of its own; make bench ARGS=--quick for a short run.
bench: .venv/.base
	$(BIN)/python benchmarks/simulator.py $(ARGS)
	$(BIN)/python benchmarks/scalar_step.py

# The server's WebSocket beside OpenEnv's echo environment.
bench-server: .venv/.dev
	$(BIN)/python benchmarks/server.py $(ARGS)

# The trainer beside Stable-Baselines3's DQN; takes half an hour.
bench-training: .venv/.dev
	$(BIN)/python benchmarks/training.py $(ARGS)

# Frames, first paint and weight of the dashboard, in the system's chromium.
bench-dashboard: .venv/.dev
	$(BIN)/python benchmarks/dashboard.py $(ARGS)

# Seconds and megabytes from an empty environment to the first flight; the dependencies of the project's first version
# beside it, resolved and not installed.
bench-install: .venv/.dev
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/python benchmarks/install.py $(ARGS)

# The wheel in an empty environment for each Python, with server and page; make wheels-check ARGS='--python 3.12'.
wheels-check: .venv/.dev
	$(BIN)/python tests/package/installed.py $(ARGS)

# What a session and a step cost the server, its store and nginx; some minutes, and needs nginx.
bench-capacity: .venv/.dev
	$(BIN)/python benchmarks/capacity.py $(ARGS)

# Evaluation on a Ray cluster of several nodes on this machine beside the plain run; ARGS="--maps 100000" for all.
bench-cluster: .venv/.dev
	$(BIN)/python benchmarks/cluster.py $(ARGS)

# Train all standard tasks with three seeds each and fly the test maps; takes an hour, and goes on where it was stopped.
evidence: .venv/.dev
	$(BIN)/python benchmarks/training_runs.py $(ARGS)

# The documentation as a site in build/site. (The variable silences what its theme prints about itself.)
docs: .venv/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# The generated pages, tables and pictures of docs/; takes minutes.
docs-data: .venv/.dev
	$(BIN)/python docs/tables.py
	$(BIN)/python docs/generate.py

# The pictures of the dashboard in docs/images, taken in the system's chromium.
screenshots: .venv/.dev
	$(BIN)/python docs/screenshots.py

# Build the container and record it in data/docker_build.log; BUILDER=podman or buildah, ARGS for more of its options.
BUILDER ?= docker
image: .venv/.base
	$(BIN)/python tools/build_image.py --builder $(BUILDER) $(ARGS)

# Build it and prove that it works: hardened, restarted, stopped, flown; docker or podman.
image-check: .venv/.dev
	$(BIN)/python tools/check_image.py --builder $(BUILDER) $(ARGS)

# Stage the folder that becomes a Hugging Face Space, in build/space.
space: .venv/.base
	$(BIN)/python tools/stage_space.py $(ARGS)

format: .venv/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv .venv-bench .venv-adapters build dist demo htmlcov .coverage .coverage.* .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
