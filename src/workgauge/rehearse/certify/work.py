"""Driving all drives of a certificate, in this process or several."""

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from workgauge.rehearse.certify.conditions import Task
from workgauge.rehearse.certify.driving import Driven, Driver, Subject

#: One drive needs one core: libraries of linear algebra must not take more.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def driven(driver: Driver, todo: Sequence[Task], jobs: int) -> Iterator[tuple[Task, Driven]]:
    """Drive what is to be done and yield each as it comes; in any order with several processes.

    The first is always driven in this process: what has to be compiled is compiled once, and not in every other.

    Args:
        driver: for this process; others make their own of its subject. jobs: how many processes.
    """
    here = todo if jobs <= 1 else todo[:1]
    for task in here:
        yield task, driver.drive(task)
    others = todo[len(here) :]
    if not others:
        return
    with _one_thread():
        pool = multiprocessing.get_context("spawn").Pool(min(jobs, len(others)), _Worker.made, (driver.subject,))
    with pool:
        yield from pool.imap_unordered(_Worker.drive, others)


class _Worker:
    """What a process drives with."""

    driver: Driver

    @classmethod
    def made(cls, subject: Subject) -> None:
        """Prepare a process; an interrupt is for the one that started it."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        cls.driver = Driver(subject)

    @classmethod
    def drive(cls, task: Task) -> tuple[Task, Driven]:
        """Drive one."""
        return task, cls.driver.drive(task)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started within use one thread each."""
    missing = [name for name in _ONE_THREAD if name not in os.environ]
    os.environ.update(dict.fromkeys(missing, "1"))
    try:
        yield
    finally:
        for name in missing:
            del os.environ[name]
