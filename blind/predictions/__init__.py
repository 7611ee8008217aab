"""The study of predictions: their intervals, and the test that notices that the model stops fitting."""
