"""Others' solvers on our problems: whole controllers, and quadratic programs of our own real-time iterations."""
