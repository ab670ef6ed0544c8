"""By what a folder of results knows the rig that they were taken with."""

import hashlib
from dataclasses import replace

from eps_hil import yaml_file
from eps_hil.bus.config import BusSetup
from eps_hil.physics.model import Model, dump_model


def fingerprint(setup: BusSetup, model: Model) -> str:
    """One number of model, databases, mapping and bus: another one, and results do not mix.

    Comments in model and mapping, and whether a lost bus is opened again, do not count.
    """
    told = hashlib.sha256(dump_model(model).encode())
    for path in setup.dbc:
        told.update(path.read_bytes())
    told.update(repr(yaml_file.read(setup.signals)).encode())
    told.update(repr(replace(setup.bus, reconnect=True)).encode())
    return told.hexdigest()
