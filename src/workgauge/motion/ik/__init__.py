"""Inverse kinematics: in closed form where the chain allows it, by a closed loop for any machine."""
