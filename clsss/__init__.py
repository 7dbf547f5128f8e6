"""Subsurface light diffusion in objects of any shape, solved with OpenCL and baked to mesh vertices."""
