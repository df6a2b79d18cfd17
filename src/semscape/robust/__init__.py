"""A contrario RANSAC: inliers without a threshold."""
