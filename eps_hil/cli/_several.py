"""``eps-hil run`` with several configurations: a process for each, under one command."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from eps_hil.errors import InputError

Say = Callable[[str], None]


def check(configs: Sequence[Path]) -> None:
    """:class:`InputError` where two would publish under one id on one bus, or one is wrong."""
    from eps_hil.bus.database import find_message, load_database
    from eps_hil.bus.mapping import load_mapping
    from eps_hil.service.config import load_config

    taken: dict[object, Path] = {}
    for path in configs:
        config = load_config(path)
        if not config.sends:
            continue
        place = str(config.bus), str(sorted(config.bus.options.items()))
        database = load_database(config.dbc, strict=load_mapping(config.signals).strict)
        for message in config.sends:
            found = find_message(database, message)
            if found is None:  # its own process will say so
                continue
            other = taken.setdefault((*place, found.frame_id, found.is_extended_frame), path)
            if other != path:
                raise InputError(
                    path, "publish",
                    f"{other} publishes {message} (0x{found.frame_id:X}) on this bus too",
                    "give each rig a bus, or messages, of its own",
                )  # fmt: skip


def names_of(configs: Sequence[Path]) -> list[str]:
    """Short names: the files', where they differ."""
    stems = [path.stem for path in configs]
    return stems if len(set(stems)) == len(stems) else [str(path) for path in configs]


def of_rig(path: Path, name: str) -> Path:
    """The file of one rig: ``log.csv`` becomes ``log-NAME.csv``."""
    return path.with_name(f"{path.stem}-{name.replace('/', '_')}{path.suffix}")


def run_several(
    configs: Sequence[Path],
    duration: float | None,
    log_estimates: Path | None,
    journal: Path,
    say: Say,
) -> int:
    """Until all have ended, or a signal; the largest exit status."""
    from eps_hil.cli._bus_options import stop_on_signals
    from eps_hil.service.fleet import Fleet, Rig
    from eps_hil.service.systemd import Notifier

    check(configs)
    rigs = []
    for config, name in zip(configs, names_of(configs), strict=True):
        words = [sys.executable, "-m", "eps_hil.cli", "run", "--no-status-line"]
        words += ["--config", str(config), "--journal", str(of_rig(journal, name))]
        words += [] if duration is None else ["--duration", str(duration)]
        log = None if log_estimates is None else of_rig(log_estimates, name)
        words += [] if log is None else ["--log-estimates", str(log)]
        rigs.append(Rig(name, tuple(words), log))
    notifier, stop = Notifier(), stop_on_signals()

    def all_ready() -> None:
        say("READY")
        notifier.ready(f"{len(rigs)} rigs")

    status = Fleet(rigs, say).run(stop, all_ready, notifier.alive)
    notifier.stopping()
    return status
