"""Isolates the tests from the user's environment, on import; `drone_env` reads variables on import as well."""

import os

SETTINGS = ("HF_TOKEN", "OPENAI_API_KEY", "API_BASE_URL", "MODEL_NAME", "DRONE_TASK", "LOCAL_IMAGE_NAME")
"""The variables of `drone-env infer`; all others of the package begin with `DRONE_ENV_`."""
KNOBS = (
    "DRONE_ENV_CACHE",  # where compiled code is kept: a run of the tests may share it with others
    "DRONE_ENV_EXAMPLES",
    "DRONE_ENV_LLM_ROUTES",
    "DRONE_ENV_PARITY_STEPS",
    "DRONE_ENV_PROMPT_MAPS",
    "DRONE_ENV_REQUIRE_TOOLS",
    "DRONE_ENV_SCHEMA_EXAMPLES",
)
"""The variables that configure the tests themselves."""
DISPLAY = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""The variables that change how programs print; pytest itself heeds them, so they are removed after it has started."""


def is_foreign(name: str) -> bool:
    """Whether a variable may change what the tests see. The settings match in lower case as well."""
    if name.upper() in SETTINGS or name in ("LANGUAGE", "MPLBACKEND"):
        return True
    return name.upper().startswith(("DRONE_ENV_", "PYTHON")) and name not in (*KNOBS, "PYTHONPATH", "PYTHONHOME")


for foreign in filter(is_foreign, list(os.environ)):
    del os.environ[foreign]
# Clients of the tests reach the servers of the tests directly, whatever proxy leads to other machines.
for bypass in ("NO_PROXY", "no_proxy"):
    os.environ[bypass] = ",".join(filter(None, (os.environ.get(bypass), "127.0.0.1,localhost")))
