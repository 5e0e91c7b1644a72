"""`companion fuzzy`: the fuzzy pilot made visible (Figs. 7-9), and its table held against scikit-fuzzy."""
