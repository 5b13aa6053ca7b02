"""What a body is and what acts on it: inertia, rates, torques, forces, equations of motion."""
