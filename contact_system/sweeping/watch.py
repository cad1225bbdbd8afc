"""Worker processes end when the process of their sweep ends."""

from __future__ import annotations

import os
import threading

WATCH = "contact_system-sweep"  # the thread that does it


def end_with(sweeper: int) -> None:
    """If this process is a worker of a sweep in another process, let it end together with that one.

    Otherwise it would wait for work forever, as it holds the other end of its queue itself.
    """
    if os.getpid() == sweeper or any(thread.name == WATCH for thread in threading.enumerate()):
        return
    from multiprocessing import parent_process  # not on the planner's path

    parent, born = parent_process(), os.getppid()
    if parent is not None and parent.pid == sweeper:

        def watch() -> None:
            # workers forked later may keep the parent's sentinel alive, hence the check of getppid;
            # a worker of a fork server is no child of the sweep, hence is_alive
            while parent.is_alive() and os.getppid() == born:
                parent.join(1.0)
            os._exit(1)

        threading.Thread(target=watch, name=WATCH, daemon=True).start()
