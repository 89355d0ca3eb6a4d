"""Regression on nominal levels and its peers; knows no robot and no effect."""
