"""Parameters of equations of motion from the error of a free run.

Start with `grey_box.GreyBox`; `collocation.Collocation` for poor starts; `advise.advise` says what to drive next.
"""
