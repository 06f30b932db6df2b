"""Checkpoints: files that cannot be read or written, and that they run no code."""

from pathlib import Path

import pytest
import torch

from drone_env.errors import CheckpointError
from drone_env.rl.run import load_checkpoint, save_checkpoint
from tests.unit.small_training import SMALL, run_in


def test_a_file_that_is_no_checkpoint_is_said_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "easy.pth"
    save_checkpoint(path, {"tensor": torch.zeros(1000)})
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"not a checkpoint"):
        path.write_bytes(content)
        # PyTorch's own message advises to load it with the right to run code.
        with pytest.raises(CheckpointError, match=r"easy\.pth cannot be read: cut short, or no checkpoint \(\w+\)$"):
            load_checkpoint(path)
        assert path.read_bytes() == content
    with pytest.raises(CheckpointError, match="--fresh"):
        run_in(tmp_path)
    assert path.read_bytes() == content
    for state, message in (({"weights": torch.zeros(3)}, "not a checkpoint of this project"),):
        torch.save(state, path)
        with pytest.raises(CheckpointError, match=message):
            load_checkpoint(path)
    save_checkpoint(path, {"config": SMALL.identity()})
    with pytest.raises(CheckpointError, match=r"easy\.pth does not fit: 'online'; --fresh"):
        run_in(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["easy.pth"]


def test_a_checkpoint_that_could_run_code_is_not_loaded(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "evil.pth", {"code": Path.home})
    with pytest.raises(CheckpointError, match="no checkpoint \\(UnpicklingError"):
        load_checkpoint(tmp_path / "evil.pth")
