"""Workers that end with the sweep which gave them work."""

from __future__ import annotations

import os
import threading

WATCH = "contact_system-sweep"  # the thread that does it


def end_with(sweeper: int) -> None:
    """See that this process, if it is a worker of the sweep in another one, ends with that one.

    It would wait for work forever, as it holds the other end of its queue itself.
    """
    if os.getpid() == sweeper or any(thread.name == WATCH for thread in threading.enumerate()):
        return
    from multiprocessing import parent_process  # not on the planner's path

    parent, born = parent_process(), os.getppid()
    if parent is not None and parent.pid == sweeper:

        def watch() -> None:
            # of forked processes later ones may keep alive what tells that the parent is gone, and
            # one of a fork server is no child of it
            while parent.is_alive() and os.getppid() == born:
                parent.join(1.0)
            os._exit(1)

        threading.Thread(target=watch, name=WATCH, daemon=True).start()
