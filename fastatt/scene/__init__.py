"""Scenes: inertia, rates, torques, forces, and the equations of motion that follow from them."""
