"""A simulated UR5 with its controller: what the client library ``ur_rtde`` connects to, without a robot."""

from labhil_sim_ur5.process import TwinProcess, running_twin
from labhil_sim_ur5.twin import CB3_TWIN, TWIN, Ur5Twin

__all__ = ["CB3_TWIN", "TWIN", "TwinProcess", "Ur5Twin", "running_twin"]
