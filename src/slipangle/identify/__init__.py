"""From data to models: each estimator is frozen settings whose ``fit`` returns a new model."""
