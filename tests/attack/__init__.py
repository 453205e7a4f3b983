"""An attack on the package: inputs, results, configurations and commands that are damaged or odd.

A case is a number; the same number is always the same case. Each runs in a child process of its
own, forked from one in which everything is imported, so that no case sees what another left and
one that hangs or dies takes nothing with it.
"""
