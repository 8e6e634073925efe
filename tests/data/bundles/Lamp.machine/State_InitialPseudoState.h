//
// State_InitialPseudoState.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class InitialPseudoState: public CLState
            {
                class Transition_0: public CLTransition
                {
                public:
                    Transition_0(int toState = 1): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                CLTransition *_transitions[1];

                public:
                    InitialPseudoState(const char *name = "InitialPseudoState");

                    virtual int numberOfTransitions() const { return 1; }

#                   include "State_InitialPseudoState_Variables.h"
            };
