"""Rehearsal: sound and motion made up by rule, so that training needs no foreign recordings."""
