//
// State_Done_Suspending.mm
//
// Automatically created through MiCASE -- do not change manually!
//
Done_Suspending::Done_Suspending(const char *name): CLState(name, *new Done_Suspending::OnEntry, *new Done_Suspending::OnExit, *new Done_Suspending::Internal)
{
	_transitions[0] = new Transition_0();
}
