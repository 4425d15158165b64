"""Figures, HTML page and video of a run, made from its files. It computes no results; import it only for drawing."""
