"""Play a CAN log onto a bus at its own pace.

The schedule is absolute: frame k is due at start + (t_k - t_0)/speed, whatever happened to the
frames before it, so lateness never adds up to drift (python-can #1372, can-utils #521). How late
each frame went out is measured and said, because a replay that quietly lags proves nothing.
"""

import contextlib
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eps_hil.bus.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame
from eps_hil.bus.live_senders import LiveSenders
from eps_hil.bus.port import Port
from eps_hil.bus.replay_choice import Choice
from eps_hil.bus.replay_controls import ReplayControls
from eps_hil.errors import InputError

_NAP_S = 0.1  # longest sleep in one piece: a stop request is seen within this time
_PAUSE_NAP_S = 0.02
_KEY_NS = 20_000_000
_LOOK_EVERY = 256  # frames that are not played
_BIN_NS = 1_000
_BINS = 1_000_000  # up to one second in steps of 1 µs
_REORDERED_NS = 1_000_000_000  # logs of several channels interleave; more is a clock set back


class Lateness:
    """Histogram of how late frames went out, in steps of 1 µs; constant memory, however long."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}
        self._total = 0
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """One frame, ``late_ns`` after it was due (negative counts as on time)."""
        place = min(max(late_ns, 0) // _BIN_NS, _BINS)
        self._counts[place] = self._counts.get(place, 0) + 1
        self._total += 1
        self.max_ns = max(self.max_ns, late_ns)

    def quantile_ns(self, share: float) -> int:
        """Lateness (ns) that ``share`` of the frames did not exceed; 0 without frames."""
        rank, seen = share * self._total, 0
        for place in sorted(self._counts):
            seen += self._counts[place]
            if seen >= rank:
                return min((place + 1) * _BIN_NS, self.max_ns)
        return self.max_ns


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay did: frames ``sent``, ``dropped`` by a full bus, ``skipped`` (error frames
    and ids not asked for), ``commands`` left out by id, its time span in the log and on the
    clock, and its lateness."""

    sent: int
    dropped: int
    skipped: int
    commands: Mapping[int, int]
    log_s: float
    wall_s: float
    late_p50_ns: int
    late_p99_ns: int
    late_max_ns: int
    stopped: bool


def read_log(path: str | Path, channel: str | None = None) -> Iterator[Frame]:
    """Frames of any log that python-can reads (by suffix: .log .blf .asc .trc .mf4 .csv .db).

    :class:`InputError` names the file and the position of whatever cannot be read; a log
    without a single frame is refused too. ``channel``: only this one of a log of several buses,
    by the name or number that the log gives it.
    """
    from eps_hil.bus.python_can import from_message

    file = Path(path)
    if not file.is_file():
        problem = "is a folder, not a CAN log" if file.is_dir() else "no such file"
        raise InputError(path, "", problem, "check the path")
    count = 0
    with contextlib.ExitStack() as stack:
        try:
            reader = stack.enter_context(_reader(file))
            for message in reader:
                if channel is not None and _channel(message.channel, file) != channel:
                    continue
                frame = _checked(from_message(message, round(message.timestamp * 1e9)))
                count += 1
                yield frame
        except InputError:
            raise
        except Exception as error:  # every format of python-can fails in its own way
            raise _unreadable(file, count, error) from None
    if not count:
        what = "CAN frames" if channel is None else f"frame of the channel {channel}"
        raise InputError(path, "", f"holds no {what}", "is it the right file?")


def _reader(file: Path) -> Any:
    import can

    if file.suffix.lower() == ".log":
        from eps_hil.bus.candump_errors import candump_reader

        return candump_reader(file)
    if file.suffix.lower() != ".asc":
        return can.LogReader(file)
    from eps_hil.bus.asc_lines import AscLines

    return can.ASCReader(AscLines(file))


def _channel(channel: object, file: Path) -> str:
    """As the log's own tools call it: python-can counts some from 0 that they count from 1."""
    shifted = file.suffix.lower() in (".blf", ".asc")
    return str(channel + 1) if shifted and isinstance(channel, int) else str(channel)


def _checked(frame: Frame) -> Frame:
    """python-can hands on whatever a log says; ValueError for what no CAN bus carries."""
    if len(frame.data) > (64 if frame.fd else 8):
        raise ValueError(f"{len(frame.data)} data bytes in one frame")
    if frame.can_id > (EXTENDED_ID_MAX if frame.extended else STANDARD_ID_MAX) and not frame.error:
        raise ValueError(f"id 0x{frame.can_id:X} is not a CAN id")
    return frame


def _unreadable(file: Path, count: int, error: Exception) -> InputError:
    said = " ".join(str(error).split())[:120] or type(error).__name__
    if isinstance(error, OSError):
        return InputError(file, "", f"cannot be read: {error.strerror or said}")
    if ("unknown" in said and "suffix" in said) or "No read support" in said:
        remedy = "use .log (candump), .blf, .asc, .trc, .mf4, .csv or .db"
        return InputError(file, "", f"'{file.suffix}' is not a format of CAN logs", remedy)
    kind = file.suffix.lower().lstrip(".")
    return InputError(
        file,
        f"after frame {count}" if count else "at the beginning",
        f"not readable as a {kind} log ({type(error).__name__}: {said})",
        "is the file complete, and of the format that its name says?",
    )


def replay(
    frames: Iterable[Frame],
    port: Port,
    *,
    speed: float | None = 1.0,
    choice: Choice | None = None,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[int], None] | None = None,
    live: LiveSenders | None = None,
    controls: ReplayControls | None = None,
    on_step: Callable[[int, Frame], None] = lambda offset_ns, frame: None,
) -> ReplayReport:
    """Send ``frames`` with the spacing of their stamps divided by ``speed`` (None: no waiting).

    Error frames are reports of a controller, not traffic, and are skipped, as are ids outside
    ``choice``, which by default has no commands. ``stop()`` is asked before each frame and at
    least every 0.1 s; ``progress(sent)`` is called now and then; ``on_step`` after a frame that
    was sent while paused. :class:`~eps_hil.errors.BusError` when the bus is gone, or somebody
    else began to send what is played.
    """
    late = Lateness()
    wanted = choice or Choice()
    sent = dropped = log_ns = 0
    pace = _Pace(speed, stop, live, controls or ReplayControls())
    for offset_ns, frame in offsets(_played(frames, wanted, pace)):
        due_ns = pace.wait(offset_ns)
        if due_ns is None:
            break
        if live is not None:
            live.sending(frame)
        accepted = port.send(frame)
        late.add(time.monotonic_ns() - due_ns)
        sent += accepted
        dropped += not accepted
        log_ns = max(log_ns, offset_ns)
        if pace.stepped:
            on_step(offset_ns, frame)
        if progress is not None and not (sent + dropped) % 256:
            progress(sent)
    return ReplayReport(
        sent=sent,
        dropped=dropped,
        skipped=wanted.skipped,
        commands=dict(wanted.commands),
        log_s=log_ns / 1e9,
        wall_s=pace.elapsed_s,
        late_p50_ns=late.quantile_ns(0.5),
        late_p99_ns=late.quantile_ns(0.99),
        late_max_ns=late.max_ns,
        stopped=pace.stopped,
    )


def _played(frames: Iterable[Frame], wanted: Choice, pace: "_Pace") -> Iterator[Frame]:
    """Those that are wanted; a stop is heard where for long none is, as in a loop without any."""
    for number, frame in enumerate(frames):
        if wanted(frame):
            yield frame
        elif number % _LOOK_EVERY == 0 and pace.over():
            return


class _Pace:
    """When each frame is due: by its place in the log, the speed, and the time spent paused."""

    def __init__(
        self,
        speed: float | None,
        stop: Callable[[], bool],
        live: LiveSenders | None,
        controls: ReplayControls,
    ) -> None:
        self._speed, self._stop, self._live, self._desk = speed, stop, live, controls
        self._begun_ns = self._started_ns = 0  # the second moves on with every pause
        self._next_key_ns = 0
        self.stopped = self.stepped = False

    @property
    def elapsed_s(self) -> float:
        """Since the first frame."""
        return (time.monotonic_ns() - self._begun_ns) / 1e9 if self._begun_ns else 0.0

    def wait(self, offset_ns: int) -> int | None:
        """Sleep until the frame at ``offset_ns`` is due; that instant, or None: stopped."""
        place_ns = 0 if self._speed is None else round(offset_ns / self._speed)
        if not self._begun_ns:
            self._begun_ns = self._started_ns = time.monotonic_ns()
        self.stepped = False
        while not self._ended():
            now_ns = time.monotonic_ns()
            if self._desk.paused:
                self._hold(now_ns - self._started_ns)
                if self.stepped:
                    self._started_ns = time.monotonic_ns() - place_ns
                    return time.monotonic_ns()
                continue
            due_ns = now_ns if self._speed is None else self._started_ns + place_ns
            if now_ns >= due_ns:
                return due_ns
            time.sleep(min((due_ns - now_ns) / 1e9, _NAP_S))
        self.stopped = True
        return None

    def _hold(self, place_ns: int) -> None:
        """Stand still at ``place_ns`` until told to go on, to take one step, or to end."""
        while self._desk.paused and not self._ended():
            self.stepped = self._desk.take_step()
            if self.stepped:
                return
            time.sleep(_PAUSE_NAP_S)
        self._started_ns = time.monotonic_ns() - place_ns

    def over(self) -> bool:
        """Whether the replay is to stop, between frames that are played."""
        self.stopped = self.stopped or self._ended()
        return self.stopped

    def _ended(self) -> bool:
        """Look at the bus and at the controls, and say whether to stop."""
        if self._live is not None:
            self._live.look()
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_key_ns:
            self._next_key_ns = now_ns + _KEY_NS
            self._desk.look()
        return self._desk.quit or self._stop()


def offsets(frames: Iterable[Frame]) -> Iterator[tuple[int, Frame]]:
    """(log time in ns since the first frame, frame); where the log's clock was set back by more
    than a second (two logs in one file), time carries on from the frame before."""
    base_ns: int | None = None
    last_ns = 0
    for frame in frames:
        if base_ns is None:
            base_ns = frame.t_ns
        offset_ns = frame.t_ns - base_ns
        if offset_ns < last_ns - _REORDERED_NS:
            base_ns, offset_ns = frame.t_ns - last_ns, last_ns
        last_ns = max(last_ns, offset_ns)
        yield offset_ns, frame


def again(make: Callable[[], Iterable[Frame]], rest_ns: int = 1_000_000) -> Iterator[Frame]:
    """The log over and over, each pass ``rest_ns`` after the last, as one stream of time."""
    end_ns: int | None = None
    while True:
        shift_ns: int | None = None
        for frame in make():
            if shift_ns is None:
                shift_ns = 0 if end_ns is None else end_ns + rest_ns - frame.t_ns
            moved = replace(frame, t_ns=frame.t_ns + shift_ns)
            end_ns = max(end_ns or moved.t_ns, moved.t_ns)
            yield moved


def parse_ids(words: Collection[str], option: str = "--ids") -> frozenset[int]:
    """``0x76,118`` and the like -> ids; :class:`InputError` naming the word that is no id."""
    ids = set()
    for word in ",".join(words).replace(",", " ").split():
        try:
            can_id = int(word, 0)
        except ValueError:
            can_id = -1
        if not 0 <= can_id <= 0x1FFF_FFFF:
            raise InputError(option, word, "is not a CAN id", "write 118 or 0x76")
        ids.add(can_id)
    return frozenset(ids)


def parse_speed(word: str) -> float | None:
    """``1.0`` -> 1.0, ``max`` -> None; :class:`InputError` for anything else."""
    if word.lower() == "max":
        return None
    try:
        speed = float(word)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < float("inf"):
        raise InputError("--speed", word, "is not a speed", "write 1.0, 0.5, 10 or max")
    return speed
