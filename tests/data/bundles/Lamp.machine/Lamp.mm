//
// Lamp.mm
//
// Automatically created through MiCASE -- do not change manually!
//
#include "Lamp.h"

Lamp::Lamp(int mid, const char *name): CLMachine(mid, name)
{
	_states[0] = new FSMLamp::State::InitialPseudoState;
	_states[1] = new FSMLamp::State::Off;
	_states[2] = new FSMLamp::State::On;
	_states[3] = new FSMLamp::State::Suspend;
	_states[4] = new FSMLamp::State::Done;
	_states[5] = new FSMLamp::State::Done_Suspending;

	setSuspendState(_states[3]);            // set suspend state
	setInitialState(_states[0]);            // set initial state
}
