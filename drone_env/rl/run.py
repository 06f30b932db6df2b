"""A training run and its files: checkpoint, log, and the exported network.

A checkpoint contains only tensors and plain values, so `weights_only=True` reads it and it cannot run code. It replaces
the previous one atomically. An exported network is read by `agents`, without PyTorch.
"""

import csv
import json
import math
import os
import signal
import sys
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import count
from pathlib import Path
from time import monotonic
from typing import Any, TextIO, cast

import torch

from drone_env import __version__
from drone_env.agents.weights_file import write_weights
from drone_env.envs.registry import FILES
from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import locked, replacing, write_text
from drone_env.rl.common import figure

FORMAT = "drone_env/checkpoint"
DIGITS = {"epsilon": 3, "loss": 6, "success": 3, "length": 1, "learning_rate": 6, "regret": 6, "cpu_seconds": 1}
"""Decimal places of the log; 4 for other figures."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; folders are made.

    Raises:
        OSError: if it cannot be written; the previous file stays.
    """
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save({"format": FORMAT, **state}, file)
        file.flush()
        os.fsync(file.fileno())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint, onto the CPU.

    Raises:
        OSError: if it cannot be read.
        CheckpointError: if it is cut short, or no checkpoint of this project.
    """
    try:
        with open(path, "rb") as file:
            state: Any = torch.load(file, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:  # damaged archives, pickles and tensors raise many types
        raise CheckpointError(f"{path} cannot be read: cut short, or no checkpoint ({type(error).__name__})") from None
    if not isinstance(state, dict) or cast(dict[str, Any], state).get("format") != FORMAT:
        raise CheckpointError(f"{path} is not a checkpoint of this project")
    return cast(dict[str, Any], state)


class TrainingRun:
    """A training with its files.

        data/<name>.pth                    the last checkpoint; it contains the best network too
        data/<name>.safetensors            the best network by validation, exported
        data/train.log                     one line per `log_every` episodes or updates
        data/train.lock                    held while a training writes to this folder
        results/<name>/config.toml         the settings, as `drone-env train --config` reads them
        results/<name>/history.csv         the log as a table, as far as the checkpoint
        results/<name>/tensorboard/        the log for TensorBoard

    A training from scratch keeps the checkpoint of an earlier one under the next free number, such as `<name>.pth.1`.
    The earlier network stays in place until a validated one replaces it.

    Args:
        trainer: A `Trainer` or `TourTrainer`; its settings name the files.
        data: Folder of checkpoint and log.
        results: Folder of table and curves.
        fresh: Start from scratch, even if there is a checkpoint.

    Raises:
        CheckpointError: if the checkpoint cannot be read or is of another run; the file stays as it is.
    """

    def __init__(self, trainer: Any, data: Path, results: Path, fresh: bool = False) -> None:
        self.trainer = trainer
        self.name: str = trainer.config.name
        self.unit: str = trainer.config.unit
        self.checkpoint = data / f"{self.name}.pth"
        self.log = data / "train.log"
        self.network = data / f"{self.name}.safetensors"
        self.results = results / self.name
        self.stopped = False
        """Set it to end the run after the current step."""
        self._seconds, self._since = 0.0, monotonic()
        self.resumed = not fresh and self._resume()

    def _resume(self) -> bool:
        """Continue from the checkpoint, if there is one."""
        try:
            state = load_checkpoint(self.checkpoint)
            self.trainer.set_state(state)
            self._seconds = state["seconds"]
            return True
        except FileNotFoundError:
            return False
        except OSError:
            raise
        except Exception as error:  # parts of another network or run raise many types
            first = (str(error).splitlines() or [type(error).__name__])[0]  # PyTorch adds lines
            reason = error if isinstance(error, CheckpointError) else f"{self.checkpoint} does not fit: {first}"
            raise CheckpointError(f"{reason}; --fresh starts again and keeps the file") from None

    @property
    def done(self) -> int:
        """Episodes or updates so far."""
        return getattr(self.trainer, self.unit)

    @property
    def total(self) -> int:
        """Episodes or updates at the end of the training."""
        return getattr(self.trainer.config, self.unit)

    @property
    def seconds(self) -> float:
        """Time of this training, including validations, files and the parts before a resume."""
        return self._seconds + monotonic() - self._since

    def train(self) -> Iterator[Any]:
        """Train to the end, or save and end after the step in which `stopped` is set.

        Yields each line of the log after it is written.

        Raises:
            InvalidValueError: if another process trains in the same folder, or if the weights are no longer finite.
        """
        trainer, config, data = self.trainer, self.trainer.config, self.log.parent
        message = f"another process is training in {data}: wait for its end, or add --data FOLDER"
        with locked(data / "train.lock", message):
            if not self.resumed and self.checkpoint.exists():
                earlier = next(path for n in count(1) if not (path := Path(f"{self.checkpoint}.{n}")).exists())
                self.checkpoint.replace(earlier)
                print(f"the earlier training is kept as {earlier}", file=sys.stderr)
            self._write_config()
            self._since = monotonic()
            saved_at, saved_done = self._since if self.resumed else None, self.done
            with self._log_file() as log, self._tensorboard() as board:
                for lines in trainer.train():
                    late = saved_at is None or monotonic() - saved_at >= config.checkpoint_seconds
                    if late and self.done - saved_done >= config.checkpoint_episodes:
                        # Save before logging: a kill loses no line of the log.
                        self.save()
                        saved_at, saved_done = monotonic(), self.done
                    for line in lines:
                        log.write(f"{log_line(line)}\n")
                        (_, step), *figures = figures_of(line).items()
                        for name, value in figures:
                            if not math.isnan(value):
                                board.add_scalar(name, value, step)
                        yield line
                    if self.stopped:
                        break
            self.save()

    def save(self) -> None:
        """Write the checkpoint, the table and, after a validation, the best network."""
        if not all(torch.isfinite(weights).all() for weights in self.trainer.online.parameters()):
            raise InvalidValueError(
                f"the training diverged: after {self.done} {self.unit} weights are infinite or NaN; nothing is saved.\n"
                "Lower --learning-rate, or raise --max-grad-norm from 0."
            )
        save_checkpoint(self.checkpoint, self.trainer.get_state() | {"seconds": self.seconds})
        if self.trainer.best:
            parameters = {name: tensor.cpu().numpy() for name, tensor in self.trainer.best.items()}
            write_weights(self.network, parameters, self.trainer.metadata())
        if self.trainer.history:
            self._write_history()

    def _log_file(self) -> TextIO:
        """The log, with the lines of the checkpoint: training repeats later ones."""
        log = self.log.open("w", encoding="utf-8", buffering=1)
        log.writelines(f"{log_line(line)}\n" for line in self.trainer.history)
        return log

    def _tensorboard(self) -> Any:
        """TensorBoard's writer; it drops steps after the checkpoint."""
        with needs("train"):
            from torch.utils.tensorboard import SummaryWriter
        return SummaryWriter(self.results / "tensorboard", purge_step=self.done + 1)

    def _write_config(self) -> None:
        config = self.trainer.config
        lines = [f"# drone-env {__version__}, PyTorch {torch.__version__}", f'algorithm = "{config.algorithm}"']
        for name, value in asdict(config).items():
            named = FILES.get((name, value), value)
            lines.append(f"{name} = {json.dumps(named, ensure_ascii=False)}")  # scalars are the same in TOML
        write_text(self.results / "config.toml", "\n".join(lines) + "\n")

    def _write_history(self) -> None:
        path = self.results / "history.csv"
        with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            rows = list(map(figures_of, self.trainer.history))
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)

    @contextmanager
    def stopping_on_interrupt(self) -> Generator[None, None, None]:
        """Inside the `with`, Ctrl-C sets `stopped`; a second one interrupts. For the main thread."""

        def stop(*_: object) -> None:
            self.stopped = True
            signal.signal(signal.SIGINT, before)
            print("\nstopping after this step; press Ctrl-C again to stop at once", file=sys.stderr)

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def figures_of(line: Any) -> dict[str, float]:
    """The figures of a log line, in order; each task's entry of `ratios` is named like `validation_hard`."""
    figures = asdict(line)
    ratios = figures.pop("ratios", {})
    return figures | {f"validation_{task}": ratio for task, ratio in ratios.items()}


def log_line(line: Any) -> str:
    """A line of `data/train.log`; `-` for an unknown figure."""
    return " ".join(
        f"{name.removeprefix('validation_')}={value if isinstance(value, int) else figure(value, DIGITS.get(name, 4))}"
        for name, value in figures_of(line).items()
    )
