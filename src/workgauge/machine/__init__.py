"""Machine description to kinematics, Jacobians, link solids and the stopping model; and the shipped catalogue."""
