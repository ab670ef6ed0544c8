"""A recording as the page's store: CAN logs by the monitor's own way, tables by their columns."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from eps_hil.dashboard.collect import Collector, late_ns
from eps_hil.dashboard.decimate import Float64, Int64, at_instants
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import (
    ANGLE,
    BALANCE,
    CELL,
    ERROR,
    ESTIMATE,
    FRICTION,
    MEASURED,
    NAMES,
    POSITION,
    SPEED,
)
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.errors import InputError
from eps_hil.monitor.alarm import limits_of
from eps_hil.monitor.residual import balance_of
from eps_hil.monitor.view_model import Monitor
from eps_hil.physics.model import Model, load_model
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.read import is_can_log, read_columns
from eps_hil.recordings.table import VALID
from eps_hil.series import Series
from eps_hil.service.config import ServiceConfig
from eps_hil.signals import PUBLISHED

_TOGETHER = 10_000
_PIECE_NS, _LAP_NS = 60_000_000_000, 1_000_000_000
"""A recording's balance is made of pieces that overlap, so that hours of it fit."""
Progress = Callable[[float], None] | None


def store_of(
    path: Path, config: ServiceConfig, on_progress: Progress = None
) -> tuple[Store, tuple[str, ...]]:
    """Everything of a recording, and the reader's notes; :class:`InputError` for a broken one."""
    if is_can_log(path):
        return _of_log(path, config, on_progress)
    columns, notes = read_columns(path, gaps="mark", ignore_unknown=True)
    series = _without_invalid(columns)
    store = Store()
    model = load_model(config.model)
    store.append(blocks_of(series, model))
    store.append(balance_of_recording(series, model))
    return _filled(path, store), notes


def _without_invalid(columns: Mapping[str, Series]) -> dict[str, Series]:
    """The signals of a table; an estimate that the file itself calls invalid is a gap."""
    series = {name: one for name, one in columns.items() if name != VALID}
    if VALID not in columns:
        return series
    valid = columns[VALID]
    for name in PUBLISHED:
        if name not in series:
            continue
        one = series[name]
        row = np.searchsorted(valid.t_ns, one.t_ns, side="right") - 1
        good = (row >= 0) & (valid.value[row] == 1.0)
        series[name] = Series(one.t_ns, np.where(good, one.value, np.nan))
    return series


def blocks_of(series: Mapping[str, Series], model: Model) -> dict[str, Block]:
    """The traces of canonical signals, at their physical instants.

    Estimates are taken as the instants that their rows speak of, as ``estimate --out`` writes them.
    """
    blocks: dict[str, Block] = {
        name: (one.t_ns - round(model.delays_s.of(name) * 1e9), one.value)
        for name, one in series.items()
        if name in (*NAMES, ANGLE)
    }
    if POSITION not in blocks and ANGLE in blocks:
        t_ns, angle = blocks[ANGLE]
        blocks[POSITION] = t_ns, angle / model.rack_to_rotor_ratio_rad_per_m
    blocks.pop(ANGLE, None)
    if ESTIMATE in blocks and CELL in blocks:
        t_ns, force = blocks[ESTIMATE]
        blocks[ERROR] = t_ns, force - at_instants(*blocks[CELL], t_ns)
    return blocks


def _of_log(
    path: Path, config: ServiceConfig, on_progress: Progress
) -> tuple[Store, tuple[str, ...]]:
    model = load_model(config.model)
    mapped = _mapped(config)
    collector = Collector(model, mapped)
    monitor = Monitor(config, limits_of(model), ear=collector)
    store, notes = Store(), list[str]()
    for k, frame in enumerate(read_frames(path, notes=notes, on_progress=on_progress), 1):
        monitor.take((frame,))
        if k % _TOGETHER == 0:
            store.append(collector.drain())
    store.append(collector.drain())
    whole = {
        name: Series(track.t_ns + late_ns(model, name), track.value)
        for name in mapped & set(MEASURED)
        if len((track := store.tracks[name]).t_ns) > 2
    }
    store.append(balance_of_recording(whole, model))
    if not len(store.tracks[ESTIMATE].t_ns) and not len(store.tracks[FRICTION].t_ns):
        notes.append("no published estimate in this log")
    return _filled(path, store), tuple(notes)


def balance_of_recording(series: Mapping[str, Series], model: Model) -> dict[str, Block]:
    """Residual of the torque balance, piece after piece; empty where a recording has none."""
    needed = {"motor_torque_nm", "rack_force_n"} - series.keys()
    if needed or not {SPEED, ANGLE} & series.keys():
        return {}
    t_ns, left_n = list[Int64](), list[Float64]()
    for first in _pieces(series):
        try:
            piece = {
                name: _between(one, first - _LAP_NS, first + _PIECE_NS + _LAP_NS)
                for name, one in series.items()
            }
            piece = {name: one for name, one in piece.items() if len(one.t_ns) > 100}
            at_ns, value = balance_of(prepare("piece", piece), piece, model)
        except ValueError:  # too short, or a signal is not there for so long
            continue
        own = (at_ns >= first) & (at_ns < first + _PIECE_NS)
        t_ns.append(at_ns[own])
        left_n.append(value[own])
    return {BALANCE: (np.concatenate(t_ns), np.concatenate(left_n))} if t_ns else {}


def _pieces(series: Mapping[str, Series]) -> list[int]:
    """Where the pieces begin in which anything is; a clock that was set may leave decades."""
    begin = min(int(one.t_ns[0]) for one in series.values())
    there = [np.unique((one.t_ns - begin) // _PIECE_NS) for one in series.values()]
    return [begin + k * _PIECE_NS for k in np.unique(np.concatenate(there)).tolist()]


def _between(one: Series, begin_ns: int, end_ns: int) -> Series:
    cut = slice(*np.searchsorted(one.t_ns, (begin_ns, end_ns)).tolist())
    return Series(one.t_ns[cut], one.value[cut])


def _mapped(config: ServiceConfig) -> frozenset[str]:
    from eps_hil.bus.mapping import load_mapping

    return frozenset(load_mapping(config.signals).signals)


def _filled(path: Path, store: Store) -> Store:
    if store.newest_ns is None:
        raise InputError(
            path, "", "holds none of the page's signals", f"it draws {', '.join(NAMES)}"
        )
    for track in store.tracks.values():
        track.begin_with_a_value()  # a service that waited for its rig published no estimate
    return store
