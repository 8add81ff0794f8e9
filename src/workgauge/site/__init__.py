"""Readers of site files (LandXML, Inframodel) and the model they fill: alignments, surfaces, points, lines."""
