"""Readers of files that others wrote: one short file for each format, all in the table `READERS`."""
