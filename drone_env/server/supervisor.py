"""The first process of a server with several: it starts, replaces and ends the others."""

import logging
import signal
import sys
import threading

from uvicorn.supervisors.multiprocess import Multiprocess, Process

from drone_env.server.process import leave_ctrl_c

log = logging.getLogger(__name__)
JOIN_SECONDS = 0.2


class Supervisor(Multiprocess):
    """uvicorn's, which ends as a server of one process does: with the same status, and at once at a second Ctrl-C."""

    _failed = _terminated = False

    def run(self) -> None:
        """Serve until stopped. Only this process handles Ctrl-C."""
        threading.Thread(target=threading.Event().wait, name="drone_env-ctrl-c", daemon=True).start()  # receives it
        leave_ctrl_c()
        super().run()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C once more, at the very end, changes no status
        if self._terminated:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.raise_signal(signal.SIGTERM)
        if self._failed:
            sys.exit(1)

    def keep_subprocess_alive(self) -> None:
        """Replace server processes that a signal has killed. One that has failed ends the server: others would, too.

        uvicorn's pings are not used. One to a process that is ending waits for a minute.
        """
        for index, old in enumerate(self.processes):
            status = old.process.exitcode
            if status is not None and status < 0:
                self.processes[index] = Process(self.config, self.sockets)
                self.processes[index].start()
            elif status is not None and not self._failed:
                log.error("a server process has failed to start: the server ends")
                self._failed = True
                self.should_exit.set()

    def handle_term(self) -> None:
        """Note the signal, and stop."""
        self._terminated = True
        super().handle_term()

    def join_all(self) -> None:
        """Wait for the server processes. A further Ctrl-C kills them."""
        for process in self.processes:
            while process.process.is_alive():
                if signal.SIGINT in self.signal_queue:
                    process.process.kill()
                process.process.join(JOIN_SECONDS)
