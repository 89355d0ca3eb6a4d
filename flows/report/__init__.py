"""Reports: sentences, tables, figures, in the terminal and on HTML pages."""
