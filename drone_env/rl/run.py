"""A training run and its files: checkpoint, log, curves, and the exported network."""

import csv
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields
from pathlib import Path
from types import FrameType
from typing import Any

from drone_env.errors import CheckpointError, MissingPackageError
from drone_env.files import replacing
from drone_env.rl.checkpoint import load_checkpoint, save_checkpoint
from drone_env.rl.config import TrainConfig
from drone_env.rl.export import export_network
from drone_env.rl.trainer import Progress, Trainer


class Run:
    """Trains, and keeps what comes of it.

        data/<task>.pth                    the last checkpoint, to go on from; it holds the best network too
        data/<task>.npz                    the best network by validation, exported
        data/train.log                     one line per `log_every` episodes
        results/<task>/history.csv         the same as a table
        results/<task>/*.png               the same as curves
        results/<task>/tensorboard/        the same for TensorBoard

    Args:
        config: How to train.
        data: Folder of checkpoint and log.
        results: Folder of tables and curves.
        fresh: Start anew; the checkpoint that is there is renamed to `.old`.
        clock: What tells the time in seconds, by which checkpoints are due.

    Raises:
        CheckpointError: if the checkpoint cannot be read or is of another run; it is left as it was.
    """

    def __init__(
        self,
        config: TrainConfig,
        data: Path,
        results: Path,
        fresh: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.trainer = Trainer(config)
        self._clock = clock
        name = self.trainer.task.short_name
        self.checkpoint = data / f"{name}.pth"
        self.log = data / "train.log"
        self.network = data / f"{name}.npz"
        self.results = results / name
        if fresh and self.checkpoint.exists():
            self.checkpoint.replace(self.checkpoint.with_suffix(".pth.old"))
        self.resumed = self.checkpoint.exists()
        self._seconds, self._since = 0.0, clock()
        if self.resumed:
            try:
                state = load_checkpoint(self.checkpoint, str(self.trainer.device))
                self.trainer.set_state(state)
                self._seconds = state["seconds"]
            except (CheckpointError, KeyError) as error:
                told = f"{self.checkpoint} lacks {error}" if isinstance(error, KeyError) else error
                raise CheckpointError(f"{told}; --fresh starts anew and keeps it as {self.checkpoint}.old") from None
        self.stopped = False

    def train(self, show: Callable[[Progress], None]) -> None:
        """Train to the end, or until Ctrl-C, which ends the run cleanly after the present step.

        Args:
            show: Called with every line of the log.
        """
        config, trainer = self.config, self.trainer
        for folder in (self.log.parent, self.results):
            folder.mkdir(parents=True, exist_ok=True)
        self._since = self._clock()
        saved_at, saved_episodes = self._since if self.resumed else None, trainer.episodes
        with self._log_file() as write, self._tensorboard() as add, self._stopping_on_interrupt():

            def save_if_due() -> None:
                nonlocal saved_at, saved_episodes
                late = saved_at is None or self._clock() - saved_at >= config.checkpoint_seconds
                if late and trainer.episodes - saved_episodes >= config.checkpoint_episodes:
                    self.save()
                    saved_at, saved_episodes = self._clock(), trainer.episodes

            def after_log(progress: Progress) -> None:
                # Saved before it is told: whoever reads that so many have been flown finds them after a kill, too.
                save_if_due()
                write(progress)
                add(progress)
                show(progress)

            def after_step() -> None:
                if not self.stopped:
                    save_if_due()
                else:
                    raise StopTraining

            with suppress(StopTraining):
                trainer.train(after_log, after_step)
        self.save()
        self._write_history()
        self._draw_curves()

    @property
    def config(self) -> TrainConfig:
        """How it trains."""
        return self.trainer.config

    @property
    def seconds(self) -> float:
        """How long this run has been trained, in all its parts, validations and files included."""
        return self._seconds + self._clock() - self._since

    def save(self) -> None:
        """Write the checkpoint, and the best network beside it."""
        save_checkpoint(self.checkpoint, self.trainer.get_state() | {"seconds": self.seconds})
        task = self.trainer.task
        metadata = {
            "task": task.id,
            "task_version": task.version,
            "telemetry_size": task.telemetry_size,
            "config": self.config.identity(),
            "episodes": self.trainer.episodes,
            "steps": self.trainer.steps,
            "updates": self.trainer.updates,
            "seconds": round(self.seconds, 1),
            "validation_score": self.trainer.best_score,
            "validation_optimum": self.trainer.validator.optimum,
        }
        export_network(self.trainer.best_network(), self.network, metadata)

    @contextmanager
    def _log_file(self) -> Generator[Callable[[Progress], None], None, None]:
        """The log, begun anew with the lines of the checkpoint: what was logged after it is flown again."""
        with replacing(self.log) as temporary:
            temporary.write_text("".join(f"{log_line(line)}\n" for line in self.trainer.history), encoding="utf-8")
        with self.log.open("a", encoding="utf-8", buffering=1) as file:

            def write(progress: Progress) -> None:
                file.write(f"{log_line(progress)}\n")

            yield write

    @contextmanager
    def _tensorboard(self) -> Generator[Callable[[Progress], None], None, None]:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise MissingPackageError("tensorboard", "train") from None
        folder = self.results / "tensorboard"
        if not self.resumed and folder.is_dir():
            for old in folder.glob("events.out.tfevents.*"):
                old.unlink()
        # Whatever came after the checkpoint is flown again, so what was written of it is taken back.
        writer: Any = SummaryWriter(folder, purge_step=self.trainer.episodes + 1)

        def add(progress: Progress) -> None:
            for name, value in asdict(progress).items():
                if name != "episode" and not math.isnan(value):
                    writer.add_scalar(name, value, progress.episode)

        try:
            yield add
        finally:
            writer.close()

    @contextmanager
    def _stopping_on_interrupt(self) -> Generator[None, None, None]:
        def stop(signum: int, frame: FrameType | None) -> None:
            if self.stopped:
                raise KeyboardInterrupt
            self.stopped = True
            print("\nstopping after this step; once more to stop at once", file=sys.stderr)

        if threading.current_thread() is not threading.main_thread():
            yield  # signals reach the main thread alone, and whoever runs there decides
            return
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
            table = csv.DictWriter(file, [field.name for field in fields(Progress)])
            table.writeheader()
            table.writerows(asdict(line) for line in self.trainer.history)

    def _draw_curves(self) -> None:
        from drone_env.rl.curves import draw_curves

        draw_curves({self.config.reward_profile: self.trainer.history}, self.trainer.task.short_name, self.results)


class StopTraining(Exception):  # noqa: N818 (it is no error)
    """Ends a run that was asked to stop."""


def log_line(progress: Progress) -> str:
    """A line of `data/train.log`; a figure that there is not yet is `-`."""
    figures = {
        "epsilon": (progress.epsilon, 3),
        "loss": (progress.loss, 6),
        "reward": (progress.reward, 4),
        "score": (progress.score, 4),
        "success": (progress.success, 3),
        "length": (progress.length, 1),
        "validation": (progress.validation, 4),
        "optimum": (progress.validation_optimum, 4),
    }
    shown = " ".join(f"{name}={figure(value, digits)}" for name, (value, digits) in figures.items())
    return f"episode={progress.episode} steps={progress.steps} updates={progress.updates} {shown}"


def figure(value: float, digits: int) -> str:
    """A number for people; `-` for one that there is not yet."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
