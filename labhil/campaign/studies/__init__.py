"""Studies (fits, diagnoses, verifications, comparisons, exports) as separate processes."""
