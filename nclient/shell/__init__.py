"""A terminal to a robot: the C names as commands, with completion, help and the state at a glance.

    text ──language──> orders ──calls──> Calls of the one table ──session──> lines to show
            reference: usage and help   completion: what may come next   glance, answers: numbers in words

Rules: nothing here but `terminal`, `prompting` and `watching` knows a keyboard, a thread or a clock; a session gets
both from outside. Whatever a command is stands in nclient.protocol.commands; only words of the shell's own stand here.
"""
