//
// State_InitialPseudoState.mm
//
// Automatically created through MiCASE -- do not change manually!
//
InitialPseudoState::InitialPseudoState(const char *name): CLState(name, *new InitialPseudoState::OnEntry, *new InitialPseudoState::OnExit, *new InitialPseudoState::Internal)
{
	_transitions[0] = new Transition_0();
}
