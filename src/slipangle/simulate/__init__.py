"""A plant, a controller and a path: closed loops and manoeuvres.

Start with `loop.closed_loop`.
"""
