"""Drivers that hold a speed while another controller steers."""
