"""Sampling of one motion: samples, moments, densities, and conversion of coefficients between noise laws."""
