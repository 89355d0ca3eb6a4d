"""Figures as data for the plotting library of the page: no picture is made here."""
