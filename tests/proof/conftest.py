"""Cases are simulated once for all tests that look at them."""

import pytest

from eps_hil.proof.cases import Case, make
from eps_hil.proof.plans import Plan


@pytest.fixture(scope="session")
def stribeck_case() -> Case:
    return make(Plan("singles", 4, (("stribeck", 0.6),), simple=True))


@pytest.fixture(scope="session")
def decoy_case() -> Case:
    return make(Plan("decoys", 4, (), decoy="nothing", simple=True))
