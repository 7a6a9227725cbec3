"""Diagnosis of the gap between a drive and its logs: how large, where, why, and how far it shrinks."""
