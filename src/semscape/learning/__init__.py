"""Learning which keypoints are worth matching: training sets, classifiers, validation, the model's file."""
