"""`companion replay`: the estimators over a log again."""
