"""Training of Gaussian splats from photos with known poses, on the CPU. Needs Numba."""
