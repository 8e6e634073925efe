//
// State_On.mm
//
// Automatically created through MiCASE -- do not change manually!
//
On::On(const char *name): CLState(name, *new On::OnEntry, *new On::OnExit, *new On::Internal)
{
	_transitions[0] = new Transition_0();
	_transitions[1] = new Transition_1();
}
