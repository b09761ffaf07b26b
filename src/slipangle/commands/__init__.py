"""One module per group of commands: ``add`` describes them, the functions run them."""
