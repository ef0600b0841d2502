"""Shared by all: arrays, parts, random numbers, files, names."""
