"""Certificates of people and of the machine that serves a lab, and the folder in which they stand."""
