"""Where tasks run: processes of this machine, or the workers of a Dask cluster.

Both give rows as they are done. A recording that takes its process down with it (memory, a crash
of a library) is tried once more, alone, and is then a failed row.
"""

import contextlib
import importlib.util
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from hashlib import sha256
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from multiprocessing.connection import wait as wait_for
from threading import Thread

from eps_hil.errors import InputError
from eps_hil.fleet.job import Job, Row, blank, run
from eps_hil.fleet.tasks import Task

Todo = Sequence[tuple[Task, str]]
"""Tasks with their keys."""
Begin = Callable[[], None] | None
_RETRIES = 2
_LOOK_S = 0.2
_THREADS = tuple(f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL"))


def check(dask: str | None) -> None:
    """Refuse, before any work, a batch that could not run there, or not write its results."""
    brings = {"pyarrow": "parquet", "matplotlib": "report", "jinja2": "report"}
    missing = sorted(
        {extra for name, extra in brings.items() if importlib.util.find_spec(name) is None}
    )
    if dask is not None and importlib.util.find_spec("distributed") is None:
        missing = ["fleet"]  # which brings the others
    if missing:
        what = " and ".join(f"'{extra}'" for extra in missing)
        asked = "batch" if dask is None else "batch --dask"
        problem = f"needs the {what} extra{'s' * (len(missing) > 1)}"
        raise InputError(asked, "", problem, f'pip install "eps_hil[{",".join(missing)}]"')


def here(job: Job, todo: Todo, processes: int | None = None, begin: Begin = None) -> Iterator[Row]:
    """In ``processes`` of this machine (default: one a core).

    The first task goes alone: what it compiles the others find in the cache. Then each process has
    one more waiting, so that none stands still while a row is kept; and linear algebra in one
    thread, since the others are at work. ``begin``: each process calls it first.
    """
    many = processes or os.cpu_count() or 1
    with _one_thread() if many > 1 else contextlib.nullcontext(), _deaf():
        yield from _here(job, todo, many, begin)


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """A Ctrl-C waits until it is asked for (:func:`_heard`), and processes that are started
    meanwhile never see it.

    Each of them would say it in a traceback; and raised anywhere here, it may leave a lock of the
    pool taken for ever.
    """
    resource_tracker.ensure_running()  # which lets it through again where it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _heard() -> None:
    """:class:`KeyboardInterrupt` where Ctrl-C was pressed; all processes are ended by then."""
    if signal.sigtimedwait({signal.SIGINT}, 0) is not None:
        for process in active_children():
            process.terminate()
        raise KeyboardInterrupt


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """For processes that are started meanwhile: their libraries read it as they are loaded."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _here(job: Job, todo: Todo, many: int, begin: Begin) -> Iterator[Row]:
    waiting, suspects = list(reversed(todo)), list[tuple[Task, str]]()
    warm = False
    while waiting or suspects:
        alone = not waiting
        if alone:
            waiting = [suspects.pop()]
        pool = ProcessPoolExecutor(
            1 if alone else many,
            get_context("spawn"),
            initializer=_end_with_parent,
            initargs=(begin,),
        )
        running: dict[Future[Row], tuple[Task, str]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < (2 * many if warm and not alone else 1):
                    # a pool that broke meanwhile refuses the task, which then goes on waiting
                    running[pool.submit(run, job, *waiting[-1])] = waiting[-1]
                    waiting.pop()
                done, _ = wait(running, _LOOK_S, return_when=FIRST_COMPLETED)
                _heard()
                for one in done:
                    row = one.result()
                    running.pop(one)
                    warm = True
                    yield row
        except BrokenProcessPool:
            if alone:
                yield _died(job, *next(iter(running.values())))
            else:
                suspects += running.values()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _end_with_parent(begin: Begin) -> None:
    """A worker whose parent was killed would wait for its next task for ever."""
    if begin is not None:
        begin()
    parent = parent_process()
    if parent is not None:
        Thread(target=_outlive_not, args=(parent.sentinel,), daemon=True).start()


def _outlive_not(parent: int) -> None:
    wait_for([parent])
    os._exit(1)


def on_dask(job: Job, todo: Todo, address: str) -> Iterator[Row]:
    """On the workers of the scheduler at ``address``, which see the same files at the same paths.

    :class:`InputError` where nobody answers.
    """
    from distributed import Client, as_completed

    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        problem = f"no scheduler answers at {address} ({type(error).__name__})"
        raise InputError("--dask", "", problem, "give its address, like tcp://host:8786") from None
    # two batches of the same recordings into two folders are not one task of the cluster
    mine = sha256(str(job.out).encode()).hexdigest()[:8]
    with client, client.as_current():
        sent = {
            client.submit(run, job, task, key, key=f"eps_hil-{mine}-{key}", retries=_RETRIES): (
                task,
                key,
            )
            for task, key in todo
        }
        for future in as_completed(list(sent)):
            if future.status == "finished":
                yield future.result()
            else:  # its workers died with it too often, or they lack the package
                cause = future.exception()
                said = " ".join(f"{type(cause).__name__}: {cause}".split())
                yield _died(job, *sent[future], said)
            future.release()


def _died(job: Job, task: Task, key: str, why: str = "out of memory, or a crash") -> Row:
    said = f"its process died ({why})"
    return {**blank(job, task, key), "state": "failed", "error": said, "seconds": None}
