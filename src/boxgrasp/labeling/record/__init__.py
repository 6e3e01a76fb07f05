"""The record of labels: a database in which nothing is overwritten."""
