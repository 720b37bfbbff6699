"""The virtual arm of the product with the physics of the second simulator: what is hidden, the way that it walks and
the noise are the product's, what it does and what its instruments show are not."""

from second_simulator.serial import ArmPhysics
from sherkit.robots.serial import VirtualSerial


class SecondArm(ArmPhysics, VirtualSerial):
    """An arm that judges the core."""
