"""Detect, describe and match keypoints."""
