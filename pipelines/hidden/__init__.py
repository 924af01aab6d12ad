"""Sealed cases for the gap workflow: how they are drawn and made, how it is run on them blind, and how its answers are judged.

Order of reading: ``machines``, ``kinds``, ``cases`` (what is tried), ``limits``, ``make`` (files), ``solve`` (the run, which
sees the site's files alone), ``judge``, ``score``, ``page``.
"""
