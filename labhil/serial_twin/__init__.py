"""The common part of the simulated devices (twins) of rigs on the framed serial link."""
