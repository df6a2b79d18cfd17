"""Rotations, cameras, epipolar geometry, triangulation and factorization: plain functions on arrays."""
