"""The first process of a server with several: it starts, replaces and ends the others."""

import signal
import sys
import threading

from uvicorn.supervisors import Multiprocess

from drone_env.server.process import STARTUP_FAILED, leave_ctrl_c

JOIN_SECONDS = 0.2


class Supervisor(Multiprocess):
    """uvicorn's, which ends as a server of one process does: with the same status, and at once at a second Ctrl-C."""

    _terminated = False

    def run(self) -> None:
        """Serve until stopped. Only this process handles Ctrl-C."""
        threading.Thread(target=threading.Event().wait, name="drone_env-ctrl-c", daemon=True).start()  # receives it
        leave_ctrl_c()
        super().run()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C once more, at the very end, changes no status
        if self._terminated:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.raise_signal(signal.SIGTERM)
        if any(process.exitcode == STARTUP_FAILED for process in self.processes):
            sys.exit(STARTUP_FAILED)

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
