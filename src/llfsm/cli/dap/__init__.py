"""``llfsm dap``: the Debug Adapter Protocol, for editors."""
