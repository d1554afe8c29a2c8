"""A policy at work: one episode at a time, in the terminal, the browser or a window."""
