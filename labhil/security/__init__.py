"""Certificates and roles of the people who may use a lab from other machines."""
