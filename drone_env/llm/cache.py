"""Answers that were paid for once, kept by what was asked: one file each, whole or not at all."""

from pathlib import Path

from pydantic import ValidationError

from drone_env.errors import InvalidValueError
from drone_env.files import replacing
from drone_env.llm.answers import Answer


class AnswerCache:
    """A folder of answers, shared by runs.

    Args:
        folder: Made where it is missing.

    Raises:
        OSError: if it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> Answer | None:
        """The answer that is kept under a key.

        Raises:
            InvalidValueError: if the file is no answer.
        """
        path = self._path(key)
        if not path.exists():
            return None
        try:
            return Answer.model_validate_json(path.read_bytes())
        except ValidationError:
            raise InvalidValueError(f"{path} is no answer: remove it") from None

    def put(self, key: str, answer: Answer) -> None:
        """Keep an answer.

        Raises:
            OSError: if it cannot be written.
        """
        path = self._path(key)
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(answer.model_dump_json(), encoding="utf-8")

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"
