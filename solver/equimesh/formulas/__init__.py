"""From the text of an expression to a program that gives its values and derivatives."""
