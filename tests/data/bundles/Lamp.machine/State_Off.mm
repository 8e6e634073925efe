//
// State_Off.mm
//
// Automatically created through MiCASE -- do not change manually!
//
Off::Off(const char *name): CLState(name, *new Off::OnEntry, *new Off::OnExit, *new Off::Internal)
{
	_transitions[0] = new Transition_0();
	_transitions[1] = new Transition_1();
}
