"""What coopqp's site needs of Sphinx: pages made from the code, links to files, formulas."""
