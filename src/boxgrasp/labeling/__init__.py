"""People teach the robot: scenes to label, the record of labels, the page, and what is learned.

`sources` gives the scenes, `record/` keeps what was said of them, `learning` trains from it and
`server/` is the page and the HTTP interface. Extra: pip install 'boxgrasp[label]'.
"""
