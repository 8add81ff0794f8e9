"""What is wanted: the operator's levers to desired joint velocity."""
