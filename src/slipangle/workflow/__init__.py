"""From one settings file to data, models, verdict, controller and page."""
