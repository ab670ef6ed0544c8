"""One rig with all that is true of it: drive, hidden physics, instruments, form of the plant."""

from dataclasses import dataclass, field

from eps_hil.proof import plant
from eps_hil.proof.truth import (
    Chain,
    Drive,
    Floats,
    Hidden,
    Slip,
    five_masses,
    lugre,
    maxwell_slip,
    one_mass,
    two_masses,
)

STIFF_BELT = 400.0


@dataclass(frozen=True, slots=True)
class Instruments:
    """What the sensors do beyond what the model file says of them (CONTRACT 8); rms by factor."""

    sensor_gain: float = 1.0
    sensor_offset_nm: float = 0.0
    sensor_play_nm: float = 0.0
    speed_late_s: float = 0.0
    speed_drift: float = 0.0
    """Relative error of the clock that stamps speed and angle."""
    noise: float = 1.0
    heavy_tails: bool = False
    encoder_step_rad: float = 0.0
    """Step of a coarse angle encoder, from which the speed is made; 0 means a resolver."""


@dataclass(frozen=True, slots=True)
class World:
    """A true rig. ``simple`` has the model file's own form: one mass, LuGre friction."""

    simple: bool
    drive: Drive = field(default_factory=Drive)
    hidden: Hidden = field(default_factory=Hidden)
    instruments: Instruments = field(default_factory=Instruments)
    belt_nm_per_rad: float = 0.0
    """Stiffness of a belt that gives; 0 means as stiff as it should be."""
    belt_damping: float = 0.02
    gap_rad: float = 0.0
    rubs_behind: bool = False
    """Whether friction acts on the rack, behind belt and gap, and not on the rotor."""
    carried_kg: float = 0.0
    """A mass on the rack that no rack force tells of."""

    def chain(self) -> Chain:
        """The masses of this rig."""
        chain = self._unloaded()
        inertia = chain.inertia.copy()
        inertia[-1] += self.carried_kg / self.drive.rack_rad_per_m**2
        return chain._replace(inertia=inertia, rubs=chain.rack if self.rubs_behind else 0)

    def _unloaded(self) -> Chain:
        belt = self.belt_nm_per_rad or STIFF_BELT
        if not self.simple:
            return five_masses(self.drive, belt, self.belt_damping, self.gap_rad)
        if self.belt_nm_per_rad or self.gap_rad:
            return two_masses(self.drive, belt, self.belt_damping, self.gap_rad)
        return one_mass(self.drive)

    def slip(self) -> Slip:
        """The friction form of this rig."""
        return lugre() if self.simple else maxwell_slip()

    def run(self, program: Floats) -> dict[str, Floats]:
        """What happens in a manoeuvre (columns of ``plant.TRUTH``)."""
        return plant.run(self.drive, self.hidden, self.chain(), self.slip(), program)
