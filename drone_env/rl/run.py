"""A training run and its files: checkpoint, log, curves, and the exported network."""

import csv
import math
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Generic, TextIO

from drone_env.errors import CheckpointError, needs
from drone_env.files import locked, replacing
from drone_env.rl.checkpoint import UNREADABLE, export_network, load_checkpoint, save_checkpoint
from drone_env.rl.curves import draw_curves
from drone_env.rl.learner import AnyLearner, figure, figures_of

DIGITS = {"epsilon": 3, "loss": 6, "success": 3, "length": 1, "learning_rate": 6, "regret": 6, "cpu_seconds": 1}
"""Decimal places of the figures of a line in the log; 4 for those not named."""


class TrainingRun(Generic[AnyLearner]):
    """Trains, and keeps what comes of it.

        data/<name>.pth                    the last checkpoint, to go on from; it holds the best network too
        data/<name>.npz                    the best network by validation, exported
        data/train.log                     one line per `log_every` episodes or updates
        results/<name>/history.csv         the same as a table
        results/<name>/*.png               the same as curves
        results/<name>/tensorboard/        the same for TensorBoard

    Args:
        trainer: What learns; its name is that of the files.
        data: Folder of checkpoint and log.
        results: Folder of tables and curves.
        fresh: Start from nothing; the checkpoint that is there is renamed to `.old`.
        clock: Gives the time in seconds, by which checkpoints are due.

    Raises:
        CheckpointError: if the checkpoint cannot be read or is of another run; it is left as it was.
        InvalidValueError: if it is to start from nothing and another process trains the same in the same folder.
    """

    def __init__(
        self,
        trainer: AnyLearner,
        data: Path,
        results: Path,
        fresh: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.trainer = trainer
        self._clock = clock
        name = trainer.name
        self.checkpoint = data / f"{name}.pth"
        self.log = data / "train.log"
        self.network = data / f"{name}.npz"
        self.results = results / name
        if fresh and self.checkpoint.exists():
            with self._alone():
                self.checkpoint.replace(self.checkpoint.with_suffix(".pth.old"))
        self.resumed = self.checkpoint.exists()
        self._seconds, self._since = 0.0, clock()
        if self.resumed:
            try:
                state = load_checkpoint(self.checkpoint, str(self.trainer.device))
                self.trainer.set_state(state)
                self._seconds = state["seconds"]
            except UNREADABLE as error:
                wrong = "lacks" if isinstance(error, KeyError) else "does not fit this training:"
                first = (str(error).splitlines() or [type(error).__name__])[0]  # PyTorch adds lines
                why = error if isinstance(error, CheckpointError) else f"{self.checkpoint} {wrong} {first}"
                raise CheckpointError(f"{why}; --fresh starts again and keeps it as {self.checkpoint}.old") from None
        self.stopped = False
        """Whether the run is to end after the present step, or has."""

    def train(self) -> Iterator[Any]:
        """Train to the end, or until `stopped` is set: the run then saves and ends after that step.

        Yields every line of the log when it is written.

        Raises:
            InvalidValueError: if another process trains the same in the same folder.
        """
        trainer = self.trainer
        most, seconds = trainer.checkpoint_gap
        for folder in (self.log.parent, self.results):
            folder.mkdir(parents=True, exist_ok=True)
        self._since = self._clock()
        saved_at, saved_done = self._since if self.resumed else None, trainer.done
        with self._alone(), self._tensorboard() as board, self._log_file() as log:
            for lines in trainer.train():
                late = saved_at is None or self._clock() - saved_at >= seconds
                if late and trainer.done - saved_done >= most:
                    # Saved before it is logged: what the log shows survives a kill.
                    self.save()
                    saved_at, saved_done = self._clock(), trainer.done
                for line in lines:
                    log.write(f"{log_line(line)}\n")
                    (_, count), *figures = figures_of(line).items()
                    for name, value in figures:
                        if not math.isnan(value):
                            board.add_scalar(name, value, count)
                    yield line
                if self.stopped:
                    break
        self.save()
        if trainer.history:
            self._write_history()
            draw_curves({trainer.name: trainer.history}, trainer.name, trainer.curves, self.results)

    @property
    def seconds(self) -> float:
        """How long this run has been trained, in all its parts, validations and files included."""
        return self._seconds + self._clock() - self._since

    def save(self) -> None:
        """Write the checkpoint, and the best network beside it."""
        save_checkpoint(self.checkpoint, self.trainer.get_state() | {"seconds": self.seconds})
        metadata = self.trainer.metadata() | {"seconds": round(self.seconds, 1)}
        export_network(self.trainer.best_network(), self.network, metadata)

    def _alone(self) -> AbstractContextManager[None]:
        """Keeps a second process from the same files."""
        taken = f"another process is training {self.checkpoint}: wait for its end, or name another folder (--data)"
        return locked(self.checkpoint.with_suffix(".lock"), taken)

    def _log_file(self) -> TextIO:
        """The log, begun again with the lines of the checkpoint: what was logged after it is flown again."""
        with replacing(self.log) as temporary:
            temporary.write_text("".join(f"{log_line(line)}\n" for line in self.trainer.history), encoding="utf-8")
        return self.log.open("a", encoding="utf-8", buffering=1)

    def _tensorboard(self) -> Any:
        """TensorBoard's writer. What it got after the checkpoint is flown again, and so taken back."""
        with needs("train"):
            from torch.utils.tensorboard import SummaryWriter
        folder = self.results / "tensorboard"
        if not self.resumed:
            for old in folder.glob("events.out.tfevents.*"):
                old.unlink()
        return SummaryWriter(folder, purge_step=self.trainer.done + 1)

    @contextmanager
    def stopping_on_interrupt(self) -> Generator[None, None, None]:
        """Inside of the `with`, Ctrl-C sets `stopped`, and a second one ends at once. For the main thread."""

        def stop(signum: int, frame: FrameType | None) -> None:
            if self.stopped:
                raise KeyboardInterrupt
            self.stopped = True
            print("\nstopping after this step; once more to stop at once", file=sys.stderr)

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _write_history(self) -> None:
        with (
            replacing(self.results / "history.csv") as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            rows = list(map(figures_of, self.trainer.history))
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)


def log_line(line: Any) -> str:
    """A line of `data/train.log`, from a line of the history; a figure that there is not yet is `-`."""
    return " ".join(
        f"{name.removeprefix('validation_')}={value if isinstance(value, int) else figure(value, DIGITS.get(name, 4))}"
        for name, value in figures_of(line).items()
    )
