"""The main job: from a log to an identified model, a verdict, a controller and a page."""
