"""The modelled world: robot, kinematics, scanner, part and collision scene."""
