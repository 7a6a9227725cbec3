"""The catalogue as hypotheses: what of each effect a log may tell, and the model that effects make of a drive."""
