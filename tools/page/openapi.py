"""Print the OpenAPI description of the server, from which the types of the page's scripts are made."""

import json
import tempfile

from drone_env.server.app import create_app
from drone_env.server.settings import Settings

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(create_app(Settings.model_validate({"data": folder})).openapi()))
