"""A recording as the page's store: CAN logs by the monitor's own way, tables by their columns."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from eps_hil.dashboard.collect import Collector
from eps_hil.dashboard.decimate import at_instants
from eps_hil.dashboard.store import Block, Store
from eps_hil.dashboard.traces import ANGLE, CELL, ERROR, ESTIMATE, FRICTION, NAMES, POSITION
from eps_hil.errors import InputError
from eps_hil.monitor.alarm import limits_of
from eps_hil.monitor.view_model import Monitor
from eps_hil.physics.model import Model, load_model
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.read import is_can_log, read_recording
from eps_hil.series import Series
from eps_hil.service.config import ServiceConfig

_TOGETHER = 10_000
Progress = Callable[[float], None] | None


def store_of(
    path: Path, config: ServiceConfig, on_progress: Progress = None
) -> tuple[Store, tuple[str, ...]]:
    """Everything of a recording, and the reader's notes; :class:`InputError` for a broken one."""
    if is_can_log(path):
        return _of_log(path, config, on_progress)
    found = read_recording(path, gaps="mark", ignore_unknown=True)
    store = Store()
    store.append(blocks_of(found.series, load_model(config.model)))
    return _filled(path, store), found.notes


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
    collector = Collector(model, _mapped(config))
    monitor = Monitor(config, limits_of(model), ear=collector)
    store, notes = Store(), list[str]()
    for k, frame in enumerate(read_frames(path, notes=notes, on_progress=on_progress), 1):
        monitor.take((frame,))
        if k % _TOGETHER == 0:
            store.append(collector.drain())
    store.append(collector.drain())
    if not len(store.tracks[ESTIMATE].t_ns) and not len(store.tracks[FRICTION].t_ns):
        notes.append("no published estimate in this log")
    return _filled(path, store), tuple(notes)


def _mapped(config: ServiceConfig) -> frozenset[str]:
    from eps_hil.bus.mapping import load_mapping

    return frozenset(load_mapping(config.signals).signals)


def _filled(path: Path, store: Store) -> Store:
    if store.newest_ns is None:
        raise InputError(
            path, "", "holds none of the page's signals", f"it draws {', '.join(NAMES)}"
        )
    for track in store.tracks.values():
        if np.isnan(track.value).all():
            track.clear()
    return store
