"""Jobs on a Dask cluster: the same jobs and results as on worker processes, on any number of machines.

Files travel with a job and come back with its result, as bytes: workers need no disk that others
see. What Dask sends is pickled by it, so a cluster must be one that its users trust; see
docs/batch.md.

**A worker of the cluster** (`plan_here`, `cancel_here`) plans on a process of its own, as on one
machine: a crash, a time-out or too much memory fails a job alone here too, and Dask hears of a
worker's end only where the worker itself has gone. What plans is not imported into the Dask worker.
"""

import contextlib
import dataclasses
import importlib.util
import json
import logging
import queue
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Self

from planner.batch.job import (
    Done,
    Event,
    Finished,
    Found,
    Job,
    Place,
    Progress,
    Record,
    all_versions,
    cancelled,
)
from planner.batch.workers import MODULE, Workers
from planner.issues import Issue, TandemError, refusal

CONNECT_S: Final = 20.0
"""Time [s] in which the scheduler of the cluster must answer."""
WORKERS_S: Final = 120.0
"""So long [s] is waited for a first worker."""
LEAST_AHEAD: Final = 4
"""Jobs at hand at least, however few threads the cluster has."""
AHEAD: Final = 2
"""Jobs at hand for each thread of the cluster."""
INSTALL: Final = "pip install 'tandem-planner[cluster]'"
"""What installs the extra that a cluster needs."""


@dataclasses.dataclass(frozen=True)
class _Sent:
    job: Job
    place: Place
    future: Any
    token: str
    since: float


class Cluster:
    """Plans jobs on the cluster whose scheduler is at ``address`` (``tcp://`` or ``tls://``), or on a
    ``local`` one of ``count`` workers; a context manager, used as `planner.batch.workers.Workers` is.

    A job whose worker disappears is planned again on another one, and counts as crashed when that happened
    as often as Dask allows (``distributed.scheduler.allowed-failures``). Raises ``TandemError``
    (``batch.install``, ``batch.field``, ``batch.cluster``).
    """

    def __init__(
        self, address: str, count: int = 1, memory_mb: float | None = None, module: str = MODULE
    ) -> None:
        if importlib.util.find_spec("distributed") is None:
            what = "a cluster needs Dask, which is not installed"
            raise refusal("batch.install", what, hint=f"install it: {INSTALL}")
        if address != "local" and not address.startswith(("tcp://", "tls://")):
            what = f"--cluster: got {address!r}; give tcp://HOST:PORT of a scheduler, or local"
            raise refusal("batch.field", what, field="--cluster")
        self._memory_mb, self._module = memory_mb, module
        self._sent: dict[str, _Sent] = {}
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._topic = f"tandem-{uuid.uuid4().hex}"
        self._open = contextlib.ExitStack()
        self._versions = all_versions()
        try:
            self._client = self._connect(address, count)
        except BaseException:
            self._open.close()
            raise

    def _connect(self, address: str, count: int) -> Any:
        import dask
        from distributed import Client, LocalCluster

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        quiet = {
            "distributed.admin.large-graph-warning-threshold": "1GB",
            "distributed.comm.timeouts.connect": f"{CONNECT_S:g}s",
        }
        self._open.enter_context(dask.config.set(quiet))
        try:
            target: Any = address
            if address == "local":
                target = self._open.enter_context(
                    LocalCluster(
                        n_workers=count,
                        threads_per_worker=1,
                        processes=True,
                        memory_limit=0,  # what plans is watched in its own process
                        dashboard_address=None,
                        silence_logs=logging.CRITICAL,
                    )
                )
            client = self._open.enter_context(Client(target, timeout=CONNECT_S, set_as_default=False))
            client.wait_for_workers(1, timeout=WORKERS_S)
        except (OSError, TimeoutError, ValueError) as error:
            what = f"cluster {address}: cannot be reached, or has no workers ({error})"
            hint = "start `dask scheduler` and `dask worker`, and give the scheduler's address"
            raise refusal("batch.cluster", what, hint=hint) from error
        client.subscribe_topic(self._topic, lambda event: self._messages.put(("event", event)))
        return client

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def busy(self) -> bool:
        """Whether any job has not ended."""
        return bool(self._sent)

    @property
    def ahead(self) -> int:
        """So many jobs at hand keep the cluster busy."""
        threads = sum(int(count) for count in self._client.nthreads().values())
        return max(LEAST_AHEAD, AHEAD * threads)

    def start(self, job: Job, folder: Path, record: Record | None = None) -> None:
        """As of `planner.batch.workers.Workers`."""
        if job.name in self._sent:
            raise ValueError(f"a job {job.name!r} is under way; wait for its end or name this one otherwise")

        if self._client.status != "running":
            raise TandemError(_gone(job.name))
        place = Place.claim(folder, record)
        token = f"tandem-{uuid.uuid4().hex}"
        more = {
            "name": job.name,
            "timeout_s": job.timeout_s,
            "memory_mb": job.memory_mb if job.memory_mb is not None else self._memory_mb,
            "origins": dict(job.origins),
            "reports": job.reports,
            "module": self._module,
        }
        arguments = (token, self._topic, dict(job.files), more, self._versions)
        future = self._client.submit(plan_here, *arguments, key=token, pure=False)
        self._sent[job.name] = _Sent(job, place, future, token, time.monotonic())
        future.add_done_callback(lambda _: self._messages.put(("ended", (job.name, token))))

    def cancel(self, name: str) -> bool:
        """As of `planner.batch.workers.Workers`."""
        sent = self._sent.pop(name, None)
        if sent is None:
            return False
        if self._client.status == "running":
            with contextlib.suppress(OSError, TimeoutError):  # where workers are gone, so is the job
                self._client.run(cancel_here, sent.token, on_error="ignore")
                sent.future.cancel(force=True)
        done = Done(name, "cancelled", (cancelled(name),), {}, time.monotonic() - sent.since)
        self._messages.put(("cancelled", Finished(name, done)))
        return True

    def events(self, timeout_s: float) -> Iterator[Event]:
        """As of `planner.batch.workers.Workers`. Raises ``TandemError`` (``batch.cluster``,
        ``batch.versions``) where the cluster is of no use any more."""
        wait_until = time.monotonic() + timeout_s
        while True:
            try:
                kind, content = self._messages.get(timeout=max(0.0, wait_until - time.monotonic()))
            except queue.Empty:
                return
            for event in self._events_in(kind, content):
                yield event
                wait_until = time.monotonic()  # what more is at hand, and no more waiting

    def close(self) -> None:
        """Let go of the cluster; jobs that are under way there are cancelled."""
        for name in tuple(self._sent):
            self.cancel(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._open.close()

    def _events_in(self, kind: str, content: Any) -> Iterator[Event]:
        if kind == "cancelled":
            yield content
        elif kind == "event":
            message = json.loads(content[1])
            event: Event
            if "progress" in message:
                event = Progress(*message["progress"])
            else:
                name, issues = message["found"]
                event = Found(name, tuple(Issue.from_dict(issue) for issue in issues))
            if event.name in self._sent:  # it may come later than the end of its job
                yield event
        else:
            name, token = content
            if name in self._sent and self._sent[name].token == token:
                yield self._end(self._sent.pop(name))

    def _end(self, sent: _Sent) -> Finished:
        status = sent.future.status
        if status == "finished":
            done = self._result(sent)
        elif status == "error":
            done = self._failed(sent)
        else:  # cancelled or lost by the scheduler, which knows nothing of us any more
            raise TandemError(_gone(sent.job.name))
        return Finished(sent.job.name, done)

    def _result(self, sent: _Sent) -> Done:
        with _told_of(sent.job.name):
            answer = sent.future.result()
        sent.future.release()
        if "versions" in answer:
            raise TandemError(self._other_versions(answer))
        done = Done.from_dict(answer["done"])
        if done.state == "cancelled":
            return done
        try:
            if answer["files"]:
                from planner.batch.results import write_result

                write_result(sent.place.prepare({})[1], answer["files"])
        except TandemError as error:
            return dataclasses.replace(done, state="crashed", issues=(*done.issues, *error.issues))
        return sent.place.publish(done)

    def _failed(self, sent: _Sent) -> Done:
        name = sent.job.name
        with _told_of(name):
            error = sent.future.exception()
        if type(error).__name__ == "KilledWorker":
            what = f"{name}: the workers that planned it disappeared, one after the other; other jobs go on"
            issue = Issue("batch.crashed", what, hint="see to the memory of the workers, and plan it again")
        elif isinstance(error, TandemError):
            issue = error.issues[0]
        else:
            what = f"{name}: {type(error).__name__}: {error}; please report this"
            issue = Issue("internal.error", what)
        return sent.place.publish(Done(name, "crashed", (issue,), {}, time.monotonic() - sent.since))

    def _other_versions(self, answer: dict[str, Any]) -> Issue:
        theirs = answer["versions"]
        names = sorted({*theirs, *self._versions})
        differing = ", ".join(
            f"{name} {theirs.get(name, 'none')} instead of {self._versions.get(name, 'none')}"
            for name in names
            if theirs.get(name) != self._versions.get(name)
        )
        what = f"worker {answer['worker']} has {differing}; results would differ"
        return Issue("batch.versions", what, hint="install the same versions on all machines")


@contextlib.contextmanager
def _told_of(job: str) -> Iterator[None]:
    """What Dask raises where the connection is lost between the end of a job and its result is told as an
    issue."""
    from distributed.client import FutureCancelledError

    try:
        yield
    except (FutureCancelledError, OSError, TimeoutError) as error:
        raise TandemError(_gone(job)) from error


def _gone(job: str) -> Issue:
    what = f"{job}: the cluster's scheduler went away"
    return Issue("batch.cluster", what, hint="start it again, and a batch with --resume")


PROGRESS_EVERY_S: Final = 0.5
"""Progress within a stage is published so often."""
NANNYS: Final = ("MALLOC_TRIM_THRESHOLD_",)
"""Dask's nanny sets it for its workers, so that what they free is given back at once. A planner asks for the
same memory again all the time, and would take 1.4 times as long."""
_cancelled: set[str] = set()
_mine = threading.local()


def plan_here(
    token: str, topic: str, files: Mapping[str, bytes], more: Mapping[str, Any], versions: Mapping[str, str]
) -> dict[str, Any]:
    """Plan one job; ``more`` are its other fields and the ``module`` of its worker, ``token`` names it in
    this cluster, and what is heard of it goes to ``topic``.

    Gives ``done`` (plain data) and ``files`` (the result folder's, by name), or ``versions`` where this
    worker's are not those asked for.
    """
    from distributed import get_worker

    own = all_versions()
    if own != dict(versions):
        return {"versions": own, "worker": get_worker().address}
    limits = more["timeout_s"], more["memory_mb"]
    job = Job(more["name"], files, *limits, more["origins"], more["reports"])
    with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
        result = Path(folder) / "result"
        done = _finished(token, topic, job, result, more["module"])
        kept = {p.relative_to(result).as_posix(): p.read_bytes() for p in _all(result)}
        return {"done": done.done.to_dict(), "files": kept}


def cancel_here(token: str) -> None:
    """End a job, if it is planned here."""
    _cancelled.add(token)


def _finished(token: str, topic: str, job: Job, result: Path, module: str) -> Finished:
    team = _team(module)
    team.start(job, result)
    published: tuple[str, float] = ("", 0.0)
    try:
        while True:
            for event in team.events(0.2):
                if isinstance(event, Finished):
                    return event
                if isinstance(event, Progress):
                    if event.stage == published[0] and time.monotonic() - published[1] < PROGRESS_EVERY_S:
                        continue
                    published = event.stage, time.monotonic()
                _publish(topic, event)
            if token in _cancelled:
                team.cancel(job.name)
    except BaseException:
        _drop_team()  # what it still does belongs to no later job
        raise
    finally:
        _cancelled.discard(token)


def _team(module: str) -> Workers:
    """The planning process of this thread, which keeps its Drake models from job to job."""
    if getattr(_mine, "module", None) != module:
        _drop_team()
        _mine.team, _mine.module = Workers(1, module=module, reports=False, unset=NANNYS), module
    team: Workers = _mine.team
    return team


def _drop_team() -> None:
    if hasattr(_mine, "team"):
        _mine.team.close()
    _mine.__dict__.clear()


def _publish(topic: str, event: Event) -> None:
    """Send an event to who asked for the job, as JSON: Dask takes no more than the plainest data."""
    from distributed import get_worker

    if isinstance(event, Progress):
        get_worker().log_event(topic, json.dumps({"progress": dataclasses.astuple(event)}))
    elif isinstance(event, Found):
        issues = [issue.to_dict() for issue in event.issues]
        get_worker().log_event(topic, json.dumps({"found": [event.name, issues]}))


def _all(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file())
