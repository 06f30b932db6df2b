"""A training run and its files: checkpoint, log, curves, and the exported network."""

import csv
import math
import shutil
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Generic, TextIO

from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import locked, replacing
from drone_env.rl.checkpoint import UNREADABLE, export_network, load_checkpoint, save_checkpoint
from drone_env.rl.curves import draw_curves
from drone_env.rl.learner import AnyLearner, DifferentRunError, figure, figures_of

DIGITS = {"epsilon": 3, "loss": 6, "success": 3, "length": 1, "learning_rate": 6, "regret": 6, "cpu_seconds": 1}
"""Decimal places of the figures of a line in the log; 4 for those not named."""
MOST_KEPT = 9
"""Earlier trainings of one name that a folder keeps: a checkpoint takes up to 100 MB."""


class TrainingRun(Generic[AnyLearner]):
    """Trains, and keeps what comes of it.

        data/<name>.pth                    the last checkpoint, to go on from; it holds the best network too
        data/<name>.npz                    the best network by validation, exported
        data/train.log                     one line per `log_every` episodes or updates
        data/train.lock                    held while a training writes to this folder
        results/<name>/history.csv         the same as a table
        results/<name>/*.png               the same as curves
        results/<name>/tensorboard/        the same for TensorBoard

    A training that starts from nothing keeps the checkpoint, network and results of an earlier one under the next free
    number, such as `<name>.pth.1`. The earlier network also stays in place until a validated one replaces it.

    Args:
        trainer: What learns; its name is that of the files.
        data: Folder of checkpoint and log.
        results: Folder of tables and curves.
        fresh: Start from nothing, even if there is a checkpoint.
        clock: Gives the time in seconds, by which checkpoints are due.

    Raises:
        CheckpointError: if the checkpoint cannot be read or is of another run; it is left as it was.
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
        self.resumed = not fresh and self.checkpoint.exists()
        self._seconds, self._since = 0.0, clock()
        if self.resumed:
            try:
                state = load_checkpoint(self.checkpoint, str(self.trainer.device))
                self.trainer.set_state(state)
                self._seconds = state["seconds"]
            except DifferentRunError as error:
                again = "use those to go on, or add --fresh to start again"
                raise CheckpointError(f"{self.checkpoint} has other settings: {error}; {again}") from None
            except UNREADABLE as error:
                wrong = "lacks" if isinstance(error, KeyError) else "does not fit this training:"
                first = (str(error).splitlines() or [type(error).__name__])[0]  # PyTorch adds lines
                why = error if isinstance(error, CheckpointError) else f"{self.checkpoint} {wrong} {first}"
                raise CheckpointError(f"{why}; add --fresh to start again and keep the file") from None
        self.stopped = False
        """Whether the run is to end after the present step, or has."""

    def train(self) -> Iterator[Any]:
        """Train to the end, or until `stopped` is set: the run then saves and ends after that step.

        Yields every line of the log when it is written.

        Raises:
            InvalidValueError: if another process trains in the same folder, or it keeps too many earlier trainings.
        """
        trainer = self.trainer
        most, seconds = trainer.checkpoint_gap
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self._alone():
            if not self.resumed:
                self._keep_earlier()
            self.results.mkdir(parents=True, exist_ok=True)
            self._since = self._clock()
            saved_at, saved_done = self._since if self.resumed else None, trainer.done
            with self._log_file() as log, self._tensorboard() as board:
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
        """Write the checkpoint and, once there has been a validation, the best network beside it."""
        save_checkpoint(self.checkpoint, self.trainer.get_state() | {"seconds": self.seconds})
        network = self.trainer.best_network()
        if network is not None:
            export_network(network, self.network, self.trainer.metadata() | {"seconds": round(self.seconds, 1)})

    def _alone(self) -> AbstractContextManager[None]:
        """Keeps a second process from the same files. The folder has one log, and so one training at a time."""
        data = self.log.parent
        taken = f"another process is training in {data}: wait for its end, or add --data FOLDER"
        return locked(data / "train.lock", taken)

    def _keep_earlier(self) -> None:
        """Keep what an earlier training left, under the next free number."""
        files = (self.network, self.checkpoint, self.results)
        if not any(file.exists() for file in files):
            return
        for number in range(1, MOST_KEPT + 1):
            network, checkpoint, results = kept = [file.with_name(f"{file.name}.{number}") for file in files]
            if not any(file.exists() for file in kept):
                break
        else:
            first = self.checkpoint.with_name(f"{self.checkpoint.name}.1")
            raise InvalidValueError(f"{first} to .{MOST_KEPT} are kept already: move or delete those not needed")
        if self.network.exists():  # copied: a server flies it until there is a validated one
            with replacing(network) as temporary:
                shutil.copy2(self.network, temporary)
        if self.results.exists():
            self.results.replace(results)
        if self.checkpoint.exists():
            self.checkpoint.replace(checkpoint)
            print(f"the earlier training is kept as {checkpoint}", file=sys.stderr)

    def _log_file(self) -> TextIO:
        """The log, with the lines of the checkpoint alone: what was logged after it is flown again.

        It is changed in place, so that whoever follows it, as `tail -f` does, goes on reading.
        """
        text = "".join(f"{log_line(line)}\n" for line in self.trainer.history).encode()
        if not self.log.exists() or self.log.is_file():
            with self.log.open("ab+") as file:
                file.seek(0)
                same = file.read(len(text)) == text
                file.truncate(len(text) if same else 0)
                if not same:
                    file.write(text)
        return self.log.open("a", encoding="utf-8", buffering=1)

    def _tensorboard(self) -> Any:
        """TensorBoard's writer. What it got after the checkpoint is flown again, and so taken back."""
        with needs("train"):
            from torch.utils.tensorboard import SummaryWriter
        return SummaryWriter(self.results / "tensorboard", purge_step=self.trainer.done + 1)

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
