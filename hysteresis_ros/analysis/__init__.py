"""Analysis of recordings: figures of merit, plots and the report. Matplotlib and Jinja2 are imported only here."""
