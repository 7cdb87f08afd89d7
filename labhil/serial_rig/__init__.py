"""The common part of the drivers of rigs on the framed serial link."""
